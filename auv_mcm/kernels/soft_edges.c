/* Moves the borders between labels under a mean intensity smeared by the point-spread function, see soft_edges.py. */

#include <math.h>
#include <stdint.h>

#define LABELS 3
#define NEIGHBOURS 8

/* What the data lose when every mean under the point spread at `at` changes by `change` times the spread. One logarithm per row
 * of the spread: a product over all of it could overflow. quotient (2, n_columns): overwritten; divisions by themselves go two at a time.
 */
static double data_change(const double *restrict data, const double *restrict mean, int64_t stride, const double *restrict spread,
                          int64_t n_rows, int64_t n_columns, double change, double *restrict quotient)
{
    double total = 0.0;
    for (int64_t row = 0; row < n_rows; row++) {
        double product = 1.0, linear = 0.0;
        for (int64_t column = 0; column < n_columns; column++) {
            const double before = mean[row * stride + column];
            const double after = before + change * spread[row * n_columns + column];
            quotient[column] = after / before;
            quotient[n_columns + column] = data[row * stride + column] * (1.0 / after - 1.0 / before);
        }
        for (int64_t column = 0; column < n_columns; column++) {
            product *= quotient[column];
            linear += quotient[n_columns + column];
        }
        total += log(product) + linear;
    }
    return total;
}

/* label (n_rows, n_columns): in, the start; out, the result. spread (2 * reach_rows + 1, 2 * reach_columns + 1). data, mean
 * (n_rows + 2 * reach_rows, n_columns + 2 * reach_columns): mean is kept up with the labels. measured, same shape: 0 where there is
 * no data, else 1. level (3): mean of each label. weight (4): of the edges right, down-left, down, down-right.
 * scratch (2 * reach_rows + 3, 2 * reach_columns + 1): overwritten. done (1): out, the sweeps made.
 */
void auv_mcm_soft_edges(int64_t n_rows, int64_t n_columns, int64_t reach_rows, int64_t reach_columns, int64_t n_sweeps, double information,
                        const double *restrict data, const double *restrict measured, double *restrict mean,
                        const double *restrict spread, const double *restrict level, const double *restrict weight,
                        uint8_t *restrict label, double *restrict scratch, int64_t *restrict done)
{
    static const int down[NEIGHBOURS] = {0, 1, 1, 1, 0, -1, -1, -1}, right[NEIGHBOURS] = {1, -1, 0, 1, -1, 1, 0, -1};
    const int64_t stride = n_columns + 2 * reach_columns;
    const int64_t high = 2 * reach_rows + 1, wide = 2 * reach_columns + 1;
    *done = 0;
    for (int64_t sweep = 0; sweep < n_sweeps; sweep++) {
        int64_t changed = 0;
        for (int64_t step = 0; step < n_rows * n_columns; step++) {
            const int64_t at = sweep % 2 ? n_rows * n_columns - 1 - step : step; /* there and back, so that no border drifts */
            const int64_t row = at / n_columns, column = at % n_columns;
            const int own = label[at];
            double alike[LABELS] = {0.0, 0.0, 0.0}, all = 0.0;
            for (int n = 0; n < NEIGHBOURS; n++) {
                const int64_t r = row + down[n], c = column + right[n];
                if (r >= 0 && r < n_rows && c >= 0 && c < n_columns) {
                    alike[label[r * n_columns + c]] += weight[n % 4];
                    all += weight[n % 4];
                }
            }
            if (alike[own] == all)
                continue;
            const int64_t corner = row * stride + column;
            double best = 0.0;
            int best_label = own;
            for (int64_t a = 0; a < high; a++)
                for (int64_t b = 0; b < wide; b++)
                    scratch[a * wide + b] = spread[a * wide + b] * measured[corner + a * stride + b];
            for (int k = 0; k < LABELS; k++) {
                if (k == own || alike[k] == 0.0)
                    continue;
                const double change = alike[own] - alike[k]
                                      + information * data_change(data + corner, mean + corner, stride, scratch, high, wide, level[k] - level[own],
                                                              scratch + high * wide);
                if (change < best) {
                    best = change;
                    best_label = k;
                }
            }
            if (best_label != own) {
                for (int64_t a = 0; a < high; a++)
                    for (int64_t b = 0; b < wide; b++)
                        mean[corner + a * stride + b] += (level[best_label] - level[own]) * scratch[a * wide + b];
                label[at] = (uint8_t)best_label;
                changed++;
            }
        }
        *done = sweep + 1;
        if (changed == 0)
            break;
    }
}
