/* Sums over cells of a picture whose edges lie between pixels: see cell_sums.py. */

#include <stdint.h>

/* sums: cumulative down the rows, (n_rows + 1, n_columns), kept for the next plane. */
static void add_down(int64_t n_rows, int64_t n_columns, const double *values, const uint8_t *valid, int counts,
                     double *sums)
{
    for (int64_t c = 0; c < n_columns; c++)
        sums[c] = 0.0;
    for (int64_t r = 0; r < n_rows; r++) {
        const double *above = sums + r * n_columns;
        double *here = sums + (r + 1) * n_columns;
        for (int64_t c = 0; c < n_columns; c++) {
            int64_t at = r * n_columns + c;
            double value = valid[at] ? (counts ? 1.0 : values[at]) : 0.0;
            here[c] = above[c] + value;
        }
    }
}

static double between(const double *sums, int64_t step, double part)
{
    return sums[0] + part * (sums[step] - sums[0]);
}

/* row, row_part: (n_down + 1) edges, the pixel before and the share of the next; column, column_part: (n_across + 1).
   sums: (n_rows + 1, n_columns) and strip: (n_columns + 1), scratch. cells: (2, n_down, n_across). */
void auv_mcm_cell_sums(int64_t n_rows, int64_t n_columns, const double *values, const uint8_t *valid, int64_t n_down,
                       const int64_t *row, const double *row_part, int64_t n_across, const int64_t *column,
                       const double *column_part, double *sums, double *strip, double *cells)
{
    for (int counts = 0; counts < 2; counts++) {
        add_down(n_rows, n_columns, values, valid, counts, sums);
        for (int64_t i = 0; i < n_down; i++) {
            const double *top = sums + row[i] * n_columns, *bottom = sums + row[i + 1] * n_columns;
            strip[0] = 0.0;
            for (int64_t c = 0; c < n_columns; c++)
                strip[c + 1] = strip[c] + (between(bottom + c, n_columns, row_part[i + 1]) -
                                           between(top + c, n_columns, row_part[i]));
            double *out = cells + (counts * n_down + i) * n_across;
            double before = between(strip + column[0], 1, column_part[0]);
            for (int64_t k = 0; k < n_across; k++) {
                double after = between(strip + column[k + 1], 1, column_part[k + 1]);
                out[k] = after - before;
                before = after;
            }
        }
    }
}
