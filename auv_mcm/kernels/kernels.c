/* Hot loops in plain C: no Python.h, called through ctypes, which releases the interpreter lock.
 *
 * Every function here has a readable numpy twin that is its oracle and its fallback. Compile with -O3
 * -ffp-contract=off: fused multiply-adds and -ffast-math would round differently from numpy.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

/* Raised whenever a signature changes, so that a stale library is refused instead of called wrongly. */
#define AUV_MCM_KERNELS_VERSION 21

int32_t auv_mcm_kernels_version(void) { return AUV_MCM_KERNELS_VERSION; }

/* Offer each bin the predecessor `step` bins above (below where negative) at a penalty. Strictly better, so that the
 * candidate offered first wins a tie. chosen: steps so far, whole numbers in the type of the costs, so that both go
 * through the same vectors.
 */
static inline void offer(int64_t first, int64_t last, int64_t step, double penalty, const double *restrict cost,
                         double *restrict best, double *restrict chosen)
{
    const double named = (double)step;
    for (int64_t bin = first; bin < last; bin++) {
        const double candidate = cost[bin + step] - penalty;
        const int better = candidate > best[bin];
        best[bin] = better ? candidate : best[bin];
        chosen[bin] = better ? named : chosen[bin];
    }
}

/* Forward pass of the best-path search, see viterbi.py for its definition.
 *
 * score (n_pings, n_bins), back (n_pings, n_bins): C-contiguous. cost (n_bins): in, the state before the first ping;
 * out, the state after the last. scratch (2, n_bins): overwritten.
 */
WIDE void auv_mcm_viterbi_forward(int64_t n_pings, int64_t n_bins, int64_t max_step, double step_cost,
                                  const double *restrict score, double *restrict cost, double *restrict scratch,
                                  int32_t *restrict back)
{
    double *restrict best = scratch, *restrict chosen = scratch + n_bins;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict row = score + ping * n_bins;
        int32_t *restrict from = back + ping * n_bins;
        double highest = -INFINITY;

        memcpy(best, cost, (size_t)n_bins * sizeof *best);
        memset(chosen, 0, (size_t)n_bins * sizeof *chosen);
        for (int64_t step = 1; step <= max_step && step < n_bins; step++) {
            const double penalty = step_cost * (double)step;
            offer(step, n_bins, -step, penalty, cost, best, chosen);
            offer(0, n_bins - step, step, penalty, cost, best, chosen);
        }
        for (int64_t bin = 0; bin < n_bins; bin++) {
            from[bin] = (int32_t)bin + (int32_t)chosen[bin];
            best[bin] += row[bin];
        }
        for (int64_t bin = 0; bin < n_bins; bin++)
            highest = best[bin] > highest ? best[bin] : highest;
        /* Only differences matter; taking the maximum off keeps an endless mission's sums small. Without one all bins
         * are alike. */
        for (int64_t bin = 0; bin < n_bins; bin++)
            cost[bin] = highest > -INFINITY ? best[bin] - highest : 0.0;
    }
}
