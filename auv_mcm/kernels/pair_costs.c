/* Costs of labels given where highlights and shadows were, see pair_costs.py. */

#include <stdint.h>

#include "wide.h"

enum { SHADOW = 1, HIGHLIGHT = 2 };

/* What is added to a label's cost by `number` pixels of the other label: less the more there are, by degrees. */
static inline double lacking(double whole, double number, double per_pixel)
{
    const double support = number * per_pixel;
    return whole * (1.0 - (support < 1.0 ? support : 1.0));
}

/* label (n_rows, n_columns). reach (n_columns): columns before each in which highlights count; attached: those behind
 * in which shadows do. scalars: cost of a highlight without shadow, share of it per pixel of shadow; the same of a
 * shadow by highlights. sums (2, n_columns + 1), behind, before (n_rows, n_columns): overwritten. cost (3, n_rows,
 * n_columns): in, zeros.
 */
WIDE void auv_mcm_pair_costs(int64_t n_rows, int64_t n_columns, const uint8_t *restrict label,
                             const int64_t *restrict reach, int64_t attached, const double *restrict scalars,
                             double *restrict sums, double *restrict behind, double *restrict before,
                             double *restrict cost)
{
    double *restrict dark = sums, *restrict bright = sums + n_columns + 1;
    const int64_t size = n_rows * n_columns;

    for (int64_t row = 0; row < n_rows; row++) {
        const uint8_t *restrict from = label + row * n_columns;
        dark[0] = bright[0] = 0.0;
        for (int64_t k = 0; k < n_columns; k++) {
            dark[k + 1] = dark[k] + (from[k] == SHADOW);
            bright[k + 1] = bright[k] + (from[k] == HIGHLIGHT);
        }
        for (int64_t k = 0; k < n_columns; k++) {
            const int64_t end = k + 1 + attached < n_columns ? k + 1 + attached : n_columns,
                          start = k > reach[k] ? k - reach[k] : 0;
            behind[row * n_columns + k] = dark[end] - dark[k + 1];
            before[row * n_columns + k] = bright[k] - bright[start];
        }
    }
    for (int64_t row = 0; row < n_rows; row++) {
        const int64_t above = row > 0 ? n_columns : 0, below = row + 1 < n_rows ? n_columns : 0;
        for (int64_t at = row * n_columns; at < (row + 1) * n_columns; at++) {
            const double shadow = behind[at] + (above ? behind[at - above] : 0.0) + (below ? behind[at + below] : 0.0);
            const double highlight = before[at] + (above ? before[at - above] : 0.0) +
                                     (below ? before[at + below] : 0.0);
            cost[HIGHLIGHT * size + at] = lacking(scalars[0], shadow, scalars[1]);
            cost[SHADOW * size + at] = lacking(scalars[2], highlight, scalars[3]);
        }
    }
}
