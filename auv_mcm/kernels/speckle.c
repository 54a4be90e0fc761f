/* Squared differences between pixels some lags apart, see speckle.py. */

#include <stdint.h>

enum { PARTS = 4 };

/* Of a row with what lies `lag` further on, n pairs: adds to *square and *number. Four sums at once keep the adder
 * busy. */
static void add_pairs(const double *a, const uint8_t *usable_a, const double *b, const uint8_t *usable_b, int64_t n,
                      double *square, int64_t *number)
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

/* plane, usable (n_rows, n_columns), usable 0 or 1. box (n_boxes, 4): first row, first column, and one past the last of
 * each, of a part of the plane. lags (n_lags). squares, numbers (n_boxes, 2, n_lags): in, zeros; out, sums over pairs
 * of rows and of columns so far apart.
 */
void auv_mcm_speckle_lags(int64_t n_columns, const double *plane, const uint8_t *usable, int64_t n_boxes,
                          const int64_t *box, int64_t n_lags, const int64_t *lags, double *squares, int64_t *numbers)
{
    for (int64_t i = 0; i < n_boxes; i++, box += 4, squares += 2 * n_lags, numbers += 2 * n_lags) {
        const int64_t wide = box[3] - box[1];
        for (int64_t row = box[0]; row < box[2]; row++) {
            const int64_t at = row * n_columns + box[1];
            for (int64_t k = 0; k < n_lags; k++) {
                const int64_t lag = lags[k], down = at + lag * n_columns;
                if (row + lag < box[2])
                    add_pairs(plane + at, usable + at, plane + down, usable + down, wide, squares + k, numbers + k);
                if (lag < wide)
                    add_pairs(plane + at, usable + at, plane + at + lag, usable + at + lag, wide - lag,
                              squares + n_lags + k, numbers + n_lags + k);
            }
        }
    }
}
