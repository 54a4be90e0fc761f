/* Mean-field sweeps of a Potts field of three labels on a grid of eight neighbours, see mean_field.py. */

#include <math.h>
#include <stdint.h>

#include "wide.h"

#define LABELS 3

/* Weighted sum of the eight neighbours' probabilities, as far as it lies in one row and in its neighbours' share of it.
 */
WIDE static void add_beside(int64_t n_rows, int64_t n_columns, const double *restrict weight,
                            const double *restrict probability, double *restrict beside, double *restrict across)
{
    for (int64_t row = 0; row < n_rows; row++) {
        const double *restrict from = probability + row * n_columns;
        double *restrict into = beside + row * n_columns, *restrict far = across + row * n_columns;
        for (int64_t k = 1; k < n_columns - 1; k++)
            into[k] = from[k - 1] + from[k + 1];
        if (n_columns > 0)
            into[0] = n_columns > 1 ? from[1] : 0.0;
        if (n_columns > 1)
            into[n_columns - 1] = from[n_columns - 2];
        for (int64_t k = 0; k < n_columns; k++)
            far[k] = weight[2] * from[k] + weight[3] * into[k];
    }
}

WIDE static void take_off_heard(int64_t n_rows, int64_t n_columns, const double *restrict weight,
                                const double *restrict beside, const double *restrict across,
                                const double *restrict cost, double *restrict left)
{
    for (int64_t row = 0; row < n_rows; row++) {
        const int64_t above = row > 0, below = row + 1 < n_rows;
        for (int64_t k = row * n_columns; k < (row + 1) * n_columns; k++) {
            double heard = weight[0] * beside[k];
            heard += above ? across[k - n_columns] : 0.0;
            heard += below ? across[k + n_columns] : 0.0;
            left[k] = cost[k] - heard;
        }
    }
}

/* cost (3, n_rows, n_columns). weight (4): of the edges right, down-left, down, down-right; both diagonals count alike.
 * probability (3, n_rows, n_columns): in and out. beside, across (n_rows, n_columns): overwritten.
 */
void auv_mcm_mean_field(int64_t n_rows, int64_t n_columns, const double *restrict cost, const double *restrict weight,
                        int64_t n_sweeps, double *restrict probability, double *restrict beside,
                        double *restrict across)
{
    const int64_t size = n_rows * n_columns;

    for (int64_t sweep = 0; sweep < n_sweeps; sweep++) {
        for (int64_t label = 0; label < LABELS; label++) {
            add_beside(n_rows, n_columns, weight, probability + label * size, beside, across);
            take_off_heard(n_rows, n_columns, weight, beside, across, cost + label * size, probability + label * size);
        }
        for (int64_t k = 0; k < size; k++) {
            const double a = probability[k], b = probability[size + k], c = probability[2 * size + k];
            const double ab = a < b ? a : b, least = ab < c ? ab : c;
            const double p = a == least ? 1.0 : exp(least - a), q = b == least ? 1.0 : exp(least - b),
                         r = c == least ? 1.0 : exp(least - c);
            const double total = p + q + r;
            probability[k] = p / total;
            probability[size + k] = q / total;
            probability[2 * size + k] = r / total;
        }
    }
}
