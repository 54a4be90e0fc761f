/* Hot loops in plain C: no Python.h, called through ctypes, which releases the interpreter lock.
 *
 * Every function here has a readable numpy twin that is its oracle and its fallback. Compile with -O3 -ffp-contract=off:
 * fused multiply-adds and -ffast-math would round differently from numpy.
 */

#include <math.h>
#include <stdint.h>

/* Raised whenever a signature changes, so that a stale library is refused instead of called wrongly. */
#define AUV_MCM_KERNELS_VERSION 13

int32_t auv_mcm_kernels_version(void) { return AUV_MCM_KERNELS_VERSION; }

/* Keep the better of two predecessors; strictly better, so that the candidate offered first wins a tie. */
static inline void offer(double candidate, int32_t predecessor, double *best, int32_t *back)
{
    if (candidate > *best) {
        *best = candidate;
        *back = predecessor;
    }
}

/* Forward pass of the best-path search, see viterbi.py for its definition.
 *
 * score (n_pings, n_bins), back (n_pings, n_bins): C-contiguous. cost (n_bins): in, the state before the first ping;
 * out, the state after the last. scratch (n_bins): overwritten.
 */
void auv_mcm_viterbi_forward(int64_t n_pings, int64_t n_bins, int64_t max_step, double step_cost, const double *restrict score,
                             double *restrict cost, double *restrict scratch, int32_t *restrict back)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict row = score + ping * n_bins;
        int32_t *restrict from = back + ping * n_bins;
        double highest = -INFINITY;

        for (int64_t bin = 0; bin < n_bins; bin++) {
            scratch[bin] = cost[bin];
            from[bin] = (int32_t)bin;
        }
        for (int64_t step = 1; step <= max_step && step < n_bins; step++) {
            const double penalty = step_cost * (double)step;
            for (int64_t bin = step; bin < n_bins; bin++)
                offer(cost[bin - step] - penalty, (int32_t)(bin - step), &scratch[bin], &from[bin]);
            for (int64_t bin = 0; bin < n_bins - step; bin++)
                offer(cost[bin + step] - penalty, (int32_t)(bin + step), &scratch[bin], &from[bin]);
        }
        for (int64_t bin = 0; bin < n_bins; bin++) {
            scratch[bin] += row[bin];
            if (scratch[bin] > highest)
                highest = scratch[bin];
        }
        /* Only differences matter; taking the maximum off keeps an endless mission's sums small. */
        if (highest == -INFINITY)
            highest = 0.0;
        for (int64_t bin = 0; bin < n_bins; bin++)
            cost[bin] = scratch[bin] - highest;
    }
}
