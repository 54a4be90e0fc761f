/* Squared differences between pixels some lags apart, see speckle.py. */

#include <stdint.h>

enum { PARTS = 4 };

/* Of a row with what lies `lag` further on, n pairs: adds to *square and *number. Four sums at once keep the adder busy. */
static void add_pairs(const double *a, const uint8_t *usable_a, const double *b, const uint8_t *usable_b, int64_t n, double *square,
                      int64_t *number)
{
    double part[PARTS] = {0.0};
    int64_t both = 0, i = 0;

    for (; i + PARTS <= n; i += PARTS) {
        for (int k = 0; k < PARTS; k++) {
            const int pair = usable_a[i + k] & usable_b[i + k];
            const double difference = pair ? b[i + k] - a[i + k] : 0.0;
            part[k] += difference * difference;
            both += pair;
        }
    }
    for (; i < n; i++) {
        const int pair = usable_a[i] & usable_b[i];
        const double difference = pair ? b[i] - a[i] : 0.0;
        part[0] += difference * difference;
        both += pair;
    }
    *square += (part[0] + part[1]) + (part[2] + part[3]);
    *number += both;
}

/* plane, usable (n_rows, n_columns), usable 0 or 1. lags (n_lags). squares, numbers (2, n_lags): in, zeros; out, sums over pairs of rows
 * and of columns so far apart.
 */
void auv_mcm_speckle_lags(int64_t n_rows, int64_t n_columns, const double *plane, const uint8_t *usable, int64_t n_lags,
                          const int64_t *lags, double *squares, int64_t *numbers)
{
    for (int64_t row = 0; row < n_rows; row++) {
        const int64_t at = row * n_columns;
        for (int64_t k = 0; k < n_lags; k++) {
            const int64_t lag = lags[k], down = at + lag * n_columns;
            if (row + lag < n_rows)
                add_pairs(plane + at, usable + at, plane + down, usable + down, n_columns, squares + k, numbers + k);
            if (lag < n_columns)
                add_pairs(plane + at, usable + at, plane + at + lag, usable + at + lag, n_columns - lag, squares + n_lags + k, numbers + n_lags + k);
        }
    }
}
