/* Moves the borders between labels under a mean intensity smeared by the point-spread function, see soft_edges.py. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

#define LABELS 3
#define NEIGHBOURS 8

/* What lies under the point spread about one pixel, n values each, row by row; the last two are of one change of the
 * mean. */
typedef struct {
    int64_t n;
    double *spread, *mean, *per_mean, *data, *quotient, *linear;
} Window;

WIDE static void invert(int64_t n, const double *restrict value, double *restrict inverse)
{
    for (int64_t i = 0; i < n; i++)
        inverse[i] = 1.0 / value[i];
}

WIDE static void weigh(int64_t n, double change, const double *restrict spread, const double *restrict mean,
                       const double *restrict per_mean, const double *restrict data, double *restrict quotient,
                       double *restrict linear)
{
    for (int64_t i = 0; i < n; i++) {
        const double after = mean[i] + change * spread[i];
        quotient[i] = after / mean[i];
        linear[i] = data[i] * (1.0 / after - per_mean[i]);
    }
}

/* What the data lose when every mean of a window changes by `change` times the spread. One logarithm per row of the
 * spread: a product over all of it could overflow.
 */
static double data_change(const Window *window, int64_t wide, double change)
{
    double total = 0.0;
    weigh(window->n, change, window->spread, window->mean, window->per_mean, window->data, window->quotient,
          window->linear);
    for (int64_t row = 0; row < window->n; row += wide) {
        double product = 1.0, linear = 0.0;
        for (int64_t i = row; i < row + wide; i++) {
            product *= window->quotient[i];
            linear += window->linear[i];
        }
        total += log(product) + linear;
    }
    return total;
}

/* label (n_rows, n_columns): in, the start; out, the result. spread (2 * reach_rows + 1, 2 * reach_columns + 1). data,
 * mean (n_rows + 2 * reach_rows, n_columns + 2 * reach_columns): mean is kept up with the labels. measured, same shape:
 * 0 where there is no data, else 1. level (3): mean of each label. weight (4): of the edges right, down-left, down,
 * down-right. scratch (6, 2 * reach_rows + 1, 2 * reach_columns + 1): overwritten. settled (n_rows, n_columns): in,
 * zeros; 1 where a pixel was left as it is and nothing that it depends on has changed since. done (1): out, the sweeps
 * made.
 */
void auv_mcm_soft_edges(int64_t n_rows, int64_t n_columns, int64_t reach_rows, int64_t reach_columns, int64_t n_sweeps,
                        double information, const double *restrict data, const double *restrict measured,
                        double *restrict mean, const double *restrict spread, const double *restrict level,
                        const double *restrict weight, uint8_t *restrict label, double *restrict scratch,
                        uint8_t *restrict settled, int64_t *restrict done)
{
    static const int down[NEIGHBOURS] = {0, 1, 1, 1, 0, -1, -1, -1}, right[NEIGHBOURS] = {1, -1, 0, 1, -1, 1, 0, -1};
    const int64_t stride = n_columns + 2 * reach_columns;
    const int64_t high = 2 * reach_rows + 1, wide = 2 * reach_columns + 1, n = high * wide;
    const int64_t far_rows = reach_rows > 0 ? 2 * reach_rows : 1,
                  far_columns = reach_columns > 0 ? 2 * reach_columns : 1;
    const Window window = {n, scratch, scratch + n, scratch + 2 * n, scratch + 3 * n, scratch + 4 * n, scratch + 5 * n};
    *done = 0;
    for (int64_t sweep = 0; sweep < n_sweeps; sweep++) {
        int64_t changed = 0;
        for (int64_t step = 0; step < n_rows * n_columns; step++) {
            const int64_t at = sweep % 2 ? n_rows * n_columns - 1 - step
                                         : step; /* there and back, so that no border drifts */
            if (settled[at])
                continue;
            const int64_t row = at / n_columns, column = at % n_columns;
            const int own = label[at];
            double alike[LABELS] = {0.0, 0.0, 0.0}, all = 0.0;
            for (int k = 0; k < NEIGHBOURS; k++) {
                const int64_t r = row + down[k], c = column + right[k];
                if (r >= 0 && r < n_rows && c >= 0 && c < n_columns) {
                    alike[label[r * n_columns + c]] += weight[k % 4];
                    all += weight[k % 4];
                }
            }
            settled[at] = 1;
            if (alike[own] == all)
                continue;
            const int64_t corner = row * stride + column;
            double best = 0.0;
            int best_label = own;
            for (int64_t a = 0; a < high; a++) {
                for (int64_t b = 0; b < wide; b++)
                    window.spread[a * wide + b] = spread[a * wide + b] * measured[corner + a * stride + b];
                memcpy(window.mean + a * wide, mean + corner + a * stride, (size_t)wide * sizeof *mean);
                memcpy(window.data + a * wide, data + corner + a * stride, (size_t)wide * sizeof *data);
            }
            invert(n, window.mean, window.per_mean);
            for (int k = 0; k < LABELS; k++) {
                if (k == own || alike[k] == 0.0)
                    continue;
                const double change = alike[own] - alike[k] +
                                      information * data_change(&window, wide, level[k] - level[own]);
                if (change < best) {
                    best = change;
                    best_label = k;
                }
            }
            if (best_label != own) {
                for (int64_t a = 0; a < high; a++)
                    for (int64_t b = 0; b < wide; b++)
                        mean[corner + a * stride + b] += (level[best_label] - level[own]) * window.spread[a * wide + b];
                label[at] = (uint8_t)best_label;
                changed++;
                const int64_t top = row > far_rows ? row - far_rows : 0,
                              left = column > far_columns ? column - far_columns : 0;
                const int64_t bottom = row + far_rows < n_rows ? row + far_rows + 1 : n_rows;
                const int64_t end = column + far_columns < n_columns ? column + far_columns + 1 : n_columns;
                for (int64_t r = top; r < bottom; r++)
                    memset(settled + r * n_columns + left, 0, (size_t)(end - left));
            }
        }
        *done = sweep + 1;
        if (changed == 0)
            break;
    }
}

/* plane, between, smeared (n_rows, n_columns), the second overwritten; share_rows (n_row_taps), share_columns
 * (n_column_taps): point spread along each axis, odd numbers. edge (n_columns + n_column_taps): overwritten. Beyond its
 * edges the plane goes on as at the edge.
 */
WIDE void auv_mcm_smear(int64_t n_rows, int64_t n_columns, const double *restrict plane, int64_t n_row_taps,
                        const double *restrict share_rows, int64_t n_column_taps, const double *restrict share_columns,
                        double *restrict between, double *restrict edge, double *restrict smeared)
{
    const int64_t half_rows = n_row_taps / 2, half_columns = n_column_taps / 2;

    for (int64_t row = 0; row < n_rows; row++) {
        double *restrict into = between + row * n_columns;
        for (int64_t tap = 0; tap < n_row_taps; tap++) {
            const int64_t wanted = row + tap - half_rows, there = wanted < 0         ? 0
                                                                  : wanted >= n_rows ? n_rows - 1
                                                                                     : wanted;
            const double *restrict from = plane + there * n_columns, share = share_rows[tap];
            if (tap == 0)
                for (int64_t column = 0; column < n_columns; column++)
                    into[column] = share * from[column];
            else
                for (int64_t column = 0; column < n_columns; column++)
                    into[column] += share * from[column];
        }
    }
    for (int64_t row = 0; row < n_rows; row++) {
        const double *restrict from = between + row * n_columns;
        double *restrict into = smeared + row * n_columns;
        for (int64_t k = 0; k < half_columns; k++) {
            edge[k] = from[0];
            edge[half_columns + n_columns + k] = from[n_columns - 1];
        }
        memcpy(edge + half_columns, from, (size_t)n_columns * sizeof *from);
        for (int64_t column = 0; column < n_columns; column++)
            into[column] = share_columns[0] * edge[column];
        for (int64_t tap = 1; tap < n_column_taps; tap++)
            for (int64_t column = 0; column < n_columns; column++)
                into[column] += share_columns[tap] * edge[column + tap];
    }
}
