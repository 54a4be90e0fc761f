/* The lowest and highest values of the blocks of a plane, see extremes of contrast.py for their definition. */

#include <stdint.h>
#include <string.h>

#include "wide.h"

/* low, high (n_columns): overwritten, by column, since in a row each comparison waits for the one before. lowest,
 * highest (blocks of rows, blocks of columns): out.
 */
WIDE void auv_mcm_contrast_extremes(int64_t n_rows, int64_t n_columns, const float *restrict plane, int64_t block_rows,
                                    int64_t block_columns, float *restrict low, float *restrict high,
                                    float *restrict lowest, float *restrict highest)
{
    for (int64_t first = 0; first < n_rows; first += block_rows) {
        const int64_t stop = first + block_rows < n_rows ? first + block_rows : n_rows;
        memcpy(low, plane + first * n_columns, (size_t)n_columns * sizeof *low);
        memcpy(high, low, (size_t)n_columns * sizeof *high);
        for (int64_t row = first + 1; row < stop; row++) {
            const float *restrict from = plane + row * n_columns;
            for (int64_t column = 0; column < n_columns; column++) {
                low[column] = from[column] < low[column] ? from[column] : low[column];
                high[column] = from[column] > high[column] ? from[column] : high[column];
            }
        }
        for (int64_t begin = 0; begin < n_columns; begin += block_columns) {
            const int64_t end = begin + block_columns < n_columns ? begin + block_columns : n_columns;
            float least = low[begin], most = high[begin];
            for (int64_t column = begin + 1; column < end; column++) {
                least = low[column] < least ? low[column] : least;
                most = high[column] > most ? high[column] : most;
            }
            *lowest++ = least;
            *highest++ = most;
        }
    }
}
