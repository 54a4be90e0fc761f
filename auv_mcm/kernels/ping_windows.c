/* Cumulants of samples inside short windows of pings, see ping_windows.py for their definition. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { PINGS = 16, WINDOW = 4, STRIDES = 3, HALVES = 2 };

/* Averages over the cells of a part, added up column by column. edges (n_cells + 1). cell k goes to out[k * step]. */
static void by_cell(const double *restrict values, int64_t n_cells, const int64_t *restrict edges, int64_t step,
                    double *restrict out)
{
    for (int64_t cell = 0; cell < n_cells; cell++) {
        double sum = values[edges[cell]];
        for (int64_t column = edges[cell] + 1; column < edges[cell + 1]; column++)
            sum += values[column];
        out[cell * step] = sum / (double)(edges[cell + 1] - edges[cell]);
    }
}

/* Adds a window's second and third k-statistic to those of its half; writes its deviations, PINGS rows `width` apart.
 */
static inline void add_window(int64_t n_part, int64_t width, const double *restrict x, int64_t first, int64_t stride,
                              double third_scale, double *restrict second, double *restrict third,
                              double *restrict deviation)
{
    const double *restrict a = x + first * width, *restrict b = x + (first + stride) * width;
    const double *restrict c = x + (first + 2 * stride) * width, *restrict d = x + (first + 3 * stride) * width;
    double *restrict da = deviation + first * width, *restrict db = deviation + (first + stride) * width;
    double *restrict dc = deviation + (first + 2 * stride) * width, *restrict dd = deviation +
                                                                                   (first + 3 * stride) * width;
    for (int64_t i = 0; i < n_part; i++) {
        const double mean = (((a[i] + b[i]) + c[i]) + d[i]) / WINDOW;
        const double p = a[i] - mean, q = b[i] - mean, r = c[i] - mean, s = d[i] - mean;
        const double pp = p * p, qq = q * q, rr = r * r, ss = s * s;
        second[i] += (((pp + qq) + rr) + ss) / (WINDOW - 1);
        third[i] += (((pp * p + qq * q) + rr * r) + ss * s) * third_scale;
        da[i] = p;
        db[i] = q;
        dc[i] = r;
        dd[i] = s;
    }
}

/* x (PINGS, n_parts n_part): parts with samples beyond `largest`, or none, become zeros. strides (STRIDES): of 1 to 4
 * pings, the largest last. kept (n_parts): out, 0 for those parts. mean, at_zero, covariance (n_parts, n_cells),
 * cumulants (STRIDES, n_parts, n_cells, HALVES, 2), highest, at_highest (n_parts): out. deviation (PINGS, n_parts
 * n_part), column (5, n_parts n_part): overwritten.
 */
WIDE void auv_mcm_ping_windows(int64_t n_parts, int64_t n_part, int64_t n_cells, const int64_t *restrict edges,
                               const int64_t *restrict strides, int64_t n_lags, const int64_t *restrict lags,
                               double largest, double *restrict x, uint8_t *restrict kept, double *restrict mean,
                               double *restrict cumulants, double *restrict covariance, double *restrict highest,
                               double *restrict at_highest, double *restrict at_zero, double *restrict deviation,
                               double *restrict column)
{
    const int64_t width = n_parts * n_part;
    const double third_scale = (double)WINDOW / ((WINDOW - 1) * (WINDOW - 2));
    double *restrict second = column, *restrict third = column + width, *restrict total = column + 2 * width;
    double *restrict zeros = column + 3 * width, *restrict product = column + 4 * width;
    for (int64_t part = 0; part < n_parts; part++) {
        double *restrict here = x + part * n_part;
        double most = -INFINITY;
        int64_t n_most = 0;
        int32_t usable = 1;
        for (int64_t ping = 0; ping < PINGS; ping++)
            for (int64_t i = 0; i < n_part; i++)
                usable &= fabs(here[ping * width + i]) <= largest;
        kept[part] = (uint8_t)usable;
        if (!usable)
            for (int64_t ping = 0; ping < PINGS; ping++)
                memset(here + ping * width, 0, (size_t)n_part * sizeof *here);
        memcpy(total, here, (size_t)n_part * sizeof *total);
        for (int64_t i = 0; i < n_part; i++)
            zeros[i] = here[i] == 0.0;
        for (int64_t ping = 1; ping < PINGS; ping++)
            for (int64_t i = 0; i < n_part; i++) {
                total[i] += here[ping * width + i];
                zeros[i] += here[ping * width + i] == 0.0;
            }
        for (int64_t i = 0; i < n_part; i++) {
            total[i] /= PINGS;
            zeros[i] /= PINGS;
        }
        by_cell(total, n_cells, edges, 1, mean + part * n_cells);
        by_cell(zeros, n_cells, edges, 1, at_zero + part * n_cells);
        for (int64_t ping = 0; ping < PINGS; ping++)
            for (int64_t i = 0; i < n_part; i++)
                most = here[ping * width + i] > most ? here[ping * width + i] : most;
        for (int64_t ping = 0; ping < PINGS; ping++)
            for (int64_t i = 0; i < n_part; i++)
                n_most += here[ping * width + i] == most;
        highest[part] = most;
        at_highest[part] = (double)n_most / (double)(PINGS * n_part);
        for (int64_t k = 0; k < STRIDES; k++)
            for (int64_t half = 0; half < HALVES; half++) {
                double *out = cumulants + ((k * n_parts + part) * n_cells * HALVES + half) * 2;
                memset(second, 0, (size_t)n_part * sizeof *second);
                memset(third, 0, (size_t)n_part * sizeof *third);
                /* Windows go by phase within groups of 4 strides; every second one belongs to this half. */
                for (int64_t window = half; window < PINGS / WINDOW; window += HALVES) {
                    const int64_t first = window / strides[k] * WINDOW * strides[k] + window % strides[k];
                    add_window(n_part, width, here, first, strides[k], third_scale, second, third,
                               deviation + part * n_part);
                }
                for (int64_t i = 0; i < n_part; i++) {
                    second[i] /= PINGS / WINDOW / HALVES;
                    third[i] /= PINGS / WINDOW / HALVES;
                }
                by_cell(second, n_cells, edges, 2 * HALVES, out);
                by_cell(third, n_cells, edges, 2 * HALVES, out + 1);
            }
    }
    memset(total, 0, (size_t)width * sizeof *total);
    for (int64_t k = 0; k < n_lags; k++) {
        const int64_t lag = lags[k], n = width > lag ? width - lag : 0;
        memset(product, 0, (size_t)width * sizeof *product);
        for (int64_t ping = 0; ping < PINGS; ping++)
            for (int64_t i = 0; i < n; i++)
                product[i] += deviation[ping * width + i + lag] * deviation[ping * width + i];
        for (int64_t i = 0; i < n; i++)
            total[i] += product[i];
    }
    for (int64_t i = 0; i < width; i++)
        total[i] /= (double)((WINDOW - 1) * (PINGS / WINDOW) * n_lags);
    for (int64_t part = 0; part < n_parts; part++)
        by_cell(total + part * n_part, n_cells, edges, 1, covariance + part * n_cells);
}
