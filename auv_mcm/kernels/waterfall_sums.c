/* Sums of a waterfall along range, and means between ranges, see waterfall_sums.py for its definition. */

#include "waterfall.h"

/* values (n_rows, n_columns). sums (n_rows, n_columns + 1): out, less the sum from each column to the last. Rows go
 * together since each sum waits for the one before.
 */
void auv_mcm_waterfall_sums(int64_t n_rows, int64_t n_columns, const float *restrict values, double *restrict sums)
{
    for (int64_t first = 0; first < n_rows; first += ROWS_TOGETHER) {
        const int64_t rows = at_most(ROWS_TOGETHER, n_rows - first), stride = n_columns + 1;
        const float *from[ROWS_TOGETHER];
        double *to[ROWS_TOGETHER], total[ROWS_TOGETHER] = {0.0};
        for (int64_t k = 0; k < ROWS_TOGETHER; k++) { /* a row too few is added up again */
            const int64_t row = first + at_most(k, rows - 1);
            from[k] = values + row * n_columns;
            to[k] = sums + row * stride;
            to[k][n_columns] = -0.0;
        }
        for (int64_t column = n_columns - 1; column >= 0; column--)
            for (int64_t k = 0; k < ROWS_TOGETHER; k++) {
                total[k] += from[k][column];
                to[k][column] = -total[k];
            }
    }
}

/* counts (n_rows, n_columns) of one or two bytes each; intensity: of every count. sums (n_rows, n_columns + 1): out, as
 * above. */
#define COUNT_SUMS(NAME, COUNT)                                                                                 \
    void NAME(int64_t n_rows, int64_t n_columns, const COUNT *restrict counts, const float *restrict intensity, \
              double *restrict sums)                                                                            \
    {                                                                                                           \
        for (int64_t first = 0; first < n_rows; first += ROWS_TOGETHER) {                                       \
            const int64_t rows = at_most(ROWS_TOGETHER, n_rows - first), stride = n_columns + 1;                \
            const COUNT *from[ROWS_TOGETHER];                                                                   \
            double *to[ROWS_TOGETHER], total[ROWS_TOGETHER] = {0.0};                                            \
            for (int64_t k = 0; k < ROWS_TOGETHER; k++) {                                                       \
                const int64_t row = first + at_most(k, rows - 1);                                               \
                from[k] = counts + row * n_columns;                                                             \
                to[k] = sums + row * stride;                                                                    \
                to[k][n_columns] = -0.0;                                                                        \
            }                                                                                                   \
            for (int64_t column = n_columns - 1; column >= 0; column--)                                         \
                for (int64_t k = 0; k < ROWS_TOGETHER; k++) {                                                   \
                    total[k] += intensity[from[k][column]];                                                     \
                    to[k][column] = -total[k];                                                                  \
                }                                                                                               \
        }                                                                                                       \
    }
COUNT_SUMS(auv_mcm_waterfall_sums_of_bytes, uint8_t)
COUNT_SUMS(auv_mcm_waterfall_sums_of_words, uint16_t)

/* Sums up to edges given in samples, whole part and fraction apart, and from each edge to the next. at (n_edges):
 * overwritten. Not WIDE: two loads are faster than a gather.
 */
static void between(int64_t n_edges, const double *restrict sums, const int32_t *restrict whole,
                    const double *restrict fraction, double *restrict at, double *restrict difference)
{
    for (int64_t edge = 0; edge < n_edges; edge++) {
        const double low = sums[whole[edge]], high = sums[whole[edge] + 1];
        at[edge] = low + fraction[edge] * (high - low);
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++)
        difference[edge] = at[edge + 1] - at[edge];
}

/* One row of edges in samples. width, sampled: from each edge to the next, as wanted and within the samples. */
WIDE static void place_edges(int64_t n_edges, int64_t n_samples, const double *restrict edges, double first,
                             double per_spacing, int32_t *restrict whole, double *restrict fraction,
                             double *restrict width, double *restrict sampled)
{
    const double last = (double)n_samples;
    for (int64_t edge = 0; edge < n_edges; edge++)
        width[edge] = (edges[edge] - first) * per_spacing + 0.5;
    for (int64_t edge = 0; edge < n_edges; edge++) {
        double position = width[edge];
        position = position < 0.0 ? 0.0 : position;
        position = position > last ? last : position;
        const int32_t sample = (int32_t)position,
                      kept = sample < (int32_t)n_samples - 1 ? sample : (int32_t)n_samples - 1;
        whole[edge] = kept;
        fraction[edge] = position - (double)kept;
        sampled[edge] = fraction[edge] + (double)kept;
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++) {
        width[edge] = width[edge + 1] - width[edge];
        sampled[edge] = sampled[edge + 1] - sampled[edge];
    }
}

/* Whether weight covers half of width, and what to divide by: weight, 1 where it does not. */
WIDE static void cover(int64_t n, const double *restrict weight, const double *restrict width, uint8_t *restrict sure,
                       double *restrict divisor)
{
    for (int64_t column = 0; column < n; column++) {
        const int32_t enough = (weight[column] >= 0.5 * width[column]) & (weight[column] > 1e-9);
        divisor[column] = enough ? weight[column] : 1.0;
        sure[column] = (uint8_t)enough;
    }
}

WIDE static void divide(int64_t n, const double *restrict divisor, const uint8_t *restrict sure, double *restrict mean)
{
    for (int64_t column = 0; column < n; column++) {
        const double value = mean[column] / divisor[column];
        mean[column] = sure[column] ? value : 0.0;
    }
}

/* sums (n_pings, n_samples + 1), weights the same or NULL; clipped (n_pings, n_near + 1) or NULL: none is beyond the
 * first n_near samples. edges (any, n_edges); edge_row (n_pings): which of them a ping has. whole (n_edges), scratch
 * (6, n_edges), covered (n_edges): overwritten. intensity, valid, saturated (n_pings, n_edges - 1): out.
 */
void auv_mcm_waterfall_means(int64_t n_pings, int64_t n_samples, int64_t n_edges, const double *restrict sums,
                             const double *restrict weights, const double *restrict clipped, int64_t n_near,
                             double first, double per_spacing, const double *restrict edges,
                             const int64_t *restrict edge_row, int32_t *restrict whole, double *restrict scratch,
                             uint8_t *restrict covered, double *restrict intensity, uint8_t *restrict valid,
                             uint8_t *restrict saturated)
{
    const int64_t n = n_edges - 1;
    double *restrict fraction = scratch, *restrict width = scratch + n_edges, *restrict sampled = scratch + 2 * n_edges;
    double *restrict at = scratch + 3 * n_edges, *restrict weight = scratch + 4 * n_edges,
                     *restrict divisor = scratch + 5 * n_edges;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        double *restrict mean = intensity + ping * n;
        uint8_t *restrict full = saturated + ping * n;
        const int is_new = ping == 0 || edge_row[ping] != edge_row[ping - 1];
        if (is_new) {
            place_edges(n_edges, n_samples, edges + edge_row[ping] * n_edges, first, per_spacing, whole, fraction,
                        width, sampled);
            if (!weights)
                cover(n, sampled, width, covered, divisor);
        }
        if (weights) {
            between(n_edges, weights + ping * (n_samples + 1), whole, fraction, at, weight);
            cover(n, weight, width, covered, divisor);
        }
        between(n_edges, sums + ping * (n_samples + 1), whole, fraction, at, mean);
        divide(n, divisor, covered, mean);
        memcpy(valid + ping * n, covered, (size_t)n);
        memset(full, 0, (size_t)n);
        if (clipped) {
            const double *restrict row = clipped + ping * (n_near + 1), *restrict share = weights ? weight : sampled;
            double before = 0.0;
            for (int64_t edge = 0; edge < n_edges; edge++) {
                const int64_t sample = at_most(whole[edge], n_near), next = at_most((int64_t)whole[edge] + 1, n_near);
                const double here = row[sample] + fraction[edge] * (row[next] - row[sample]);
                if (edge > 0)
                    full[edge - 1] = (uint8_t)((here - before > 0.25 * share[edge - 1]) & covered[edge - 1]);
                before = here;
                if (row[sample] == 0.0)
                    break; /* nothing is clipped from here on */
            }
        }
    }
}
