/* Means of a waterfall in a box around each pixel, see waterfall_boxes.py for its definition. */

#include "waterfall.h"

/* intensity, mask (n): usable are pixels that are VALID and not SATURATED. level: out, intensity, 0 where not usable;
 * bounded: the same within [low, high], 1 where not usable.
 */
WIDE void auv_mcm_waterfall_usable(int64_t n, const float *restrict intensity, const uint8_t *restrict mask, float low,
                                   float high, float *restrict level, float *restrict bounded, uint8_t *restrict usable)
{
    for (int64_t i = 0; i < n; i++) {
        const int32_t is = (mask[i] & (VALID | SATURATED)) == VALID;
        const float above = intensity[i] < low ? low : intensity[i], within = above > high ? high : above;
        usable[i] = (uint8_t)is;
        level[i] = is ? intensity[i] : 0.0f;
        bounded[i] = is ? within : 1.0f;
    }
}

/* What a box of rows holds: sums above its first row and below its last one, from the image's corner on, and valid
 * pixels by column. Of the box around each column: count, how many pixels are valid, and per_count, one over that or 1.
 */
typedef struct {
    double *lower, *upper, *band, *enters, *leaves, *per_count;
    int32_t *valid, *n_band, *count;
} Box;

/* Running sums along `rows` rows of an image from row `first` on, sums (ROWS_TOGETHER, n); rows outside the image are
 * left out. Rows go together since each sum waits for the one before.
 */
static void sum_rows(int64_t first, int64_t rows, int64_t n_rows, int64_t n, const float *restrict values,
                     double *restrict sums)
{
    const int64_t begin = first < 0 ? 0 : first, end = at_most(first + rows, n_rows);
    if (begin >= end)
        return;
    const float *from[ROWS_TOGETHER];
    double *to[ROWS_TOGETHER], total[ROWS_TOGETHER] = {0.0};
    for (int64_t k = 0; k < ROWS_TOGETHER; k++) { /* a row too few is added up again */
        const int64_t row = begin + at_most(k, end - begin - 1);
        from[k] = values + row * n;
        to[k] = sums + (row - first) * n;
    }
    for (int64_t column = 0; column < n; column++)
        for (int64_t k = 0; k < ROWS_TOGETHER; k++) {
            total[k] += from[k][column];
            to[k][column] = total[k];
        }
}

WIDE static void add_row(int64_t n, const double *restrict sums, double *restrict to)
{
    for (int64_t column = 0; column < n; column++)
        to[column + 1] += sums[column];
}

WIDE static void count_row(int64_t n, const uint8_t *restrict usable, int32_t sign, int32_t *restrict valid)
{
    for (int64_t column = 0; column < n; column++)
        valid[column] += sign * (int32_t)usable[column];
}

/* Running sums along the box's rows, with what stands at their ends repeated `pad` times on either side. */
WIDE static void spread(int64_t n, int64_t pad, Box box)
{
    double *restrict band = box.band;
    const double *restrict lower = box.lower, *restrict upper = box.upper;
    for (int64_t column = 0; column <= n; column++)
        band[pad + column] = lower[column] - upper[column];
    for (int64_t column = 0; column < pad; column++) {
        band[column] = band[pad];
        band[pad + n + 1 + column] = band[pad + n];
    }
}

/* Count valid pixels, likewise. */
WIDE static void recount(int64_t n, int64_t pad, Box box)
{
    int32_t running = 0, *restrict n_band = box.n_band, *restrict count = box.count;
    double *restrict per_count = box.per_count;
    for (int64_t column = 0; column < n; column++) {
        n_band[pad + column] = running;
        running += box.valid[column];
    }
    n_band[pad + n] = running;
    for (int64_t column = 0; column < pad; column++) {
        n_band[column] = n_band[pad];
        n_band[pad + n + 1 + column] = n_band[pad + n];
    }
    for (int64_t column = 0; column < n; column++) {
        count[column] = n_band[column + 2 * pad] - n_band[column + 1];
        per_count[column] = 1.0 / (double)(count[column] > 1 ? count[column] : 1);
    }
}

/* room (2 (n_columns + 1) + n_columns + 1 + 2 pad + 2 ROWS_TOGETHER n_columns + n_columns), n_room (n_columns +
 * n_columns + 1 + 2 pad + n_columns): overwritten.
 */
static Box empty_box(int64_t n_columns, int64_t pad, double *room, int32_t *n_room)
{
    double *const enters = room + 3 * (n_columns + 1) + 2 * pad;
    int32_t *const n_band = n_room + n_columns;
    const Box box = {room,
                     room + n_columns + 1,
                     room + 2 * (n_columns + 1),
                     enters,
                     enters + ROWS_TOGETHER * n_columns,
                     enters + 2 * ROWS_TOGETHER * n_columns,
                     n_room,
                     n_band,
                     n_band + n_columns + 1 + 2 * pad};
    memset(room, 0, (size_t)(2 * (n_columns + 1)) * sizeof *room);
    memset(n_room, 0, (size_t)n_columns * sizeof *n_room);
    return box;
}

/* The box goes on by one row, to those around `row`, the first time from -half_rows. Rows of the same usable pixels
 * leave the counts as they are, which most rows do.
 */
static void enter_row(int64_t row, int64_t n_rows, int64_t n_columns, int64_t half_rows, int64_t pad,
                      const float *values, const uint8_t *usable, Box box)
{
    const int64_t enters = row + half_rows, leaves = row - half_rows - 1, k = enters % ROWS_TOGETHER;
    const uint8_t *more = enters < n_rows ? usable + enters * n_columns : NULL,
                  *less = leaves >= 0 ? usable + leaves * n_columns : NULL;
    if (k == 0) {
        sum_rows(enters, ROWS_TOGETHER, n_rows, n_columns, values, box.enters);
        sum_rows(leaves, ROWS_TOGETHER, n_rows, n_columns, values, box.leaves);
    }
    if (more)
        add_row(n_columns, box.enters + k * n_columns, box.lower);
    if (less)
        add_row(n_columns, box.leaves + k * n_columns, box.upper);
    const int is_same = (!more && !less) || (more && less && memcmp(more, less, (size_t)n_columns) == 0);
    if (more && !is_same)
        count_row(n_columns, more, 1, box.valid);
    if (less && !is_same)
        count_row(n_columns, less, -1, box.valid);
    if (row >= 0 && (!is_same || row == 0))
        recount(n_columns, pad, box);
    if (row >= 0)
        spread(n_columns, pad, box);
}

/* band: from `pad` columns before the first on. */
WIDE static void box_means(int64_t n, int64_t pad, const double *restrict band, const double *restrict per_count,
                           double *restrict mean)
{
    for (int64_t column = 0; column < n; column++)
        mean[column] = (band[column + 2 * pad] - band[column + 1]) * per_count[column];
}

/* Whether any pixel of a row may reach its limit: a first look at all, since hardly any does. */
WIDE static int32_t any_bright(int64_t n, const float *restrict logarithms, const uint8_t *restrict usable,
                               const double *restrict mean, double above, double highest, double slack,
                               uint8_t *restrict bright)
{
    int32_t any = 0;
    for (int64_t column = 0; column < n; column++) {
        const double limit = mean[column] + above;
        const int32_t is = (usable[column] != 0) &
                           ((double)logarithms[column] + slack >= (limit < highest ? limit : highest));
        bright[column] = (uint8_t)is;
        any |= is;
    }
    return any;
}

/* logarithms, usable (n_rows, n_columns). mean, bright (n_columns), room, n_room: overwritten. places, limits
 * (n_at_most): out, n_places (1): how many there are, even if only the first n_at_most are written.
 */
void auv_mcm_waterfall_glints(int64_t n_rows, int64_t n_columns, int64_t half_rows, int64_t half_columns,
                              const float *restrict logarithms, const uint8_t *restrict usable, double above,
                              double highest, double slack, double *restrict mean, uint8_t *restrict bright,
                              double *room, int32_t *n_room, int64_t n_at_most, int32_t *restrict places,
                              double *restrict limits, int64_t *restrict n_places)
{
    const int64_t pad = half_columns + 1;
    const Box box = empty_box(n_columns, pad, room, n_room);
    int64_t n = 0;
    for (int64_t row = -half_rows; row < n_rows; row++) {
        enter_row(row, n_rows, n_columns, half_rows, pad, logarithms, usable, box);
        if (row < 0)
            continue;
        box_means(n_columns, pad, box.band, box.per_count, mean);
        if (!any_bright(n_columns, logarithms + row * n_columns, usable + row * n_columns, mean, above, highest, slack,
                        bright))
            continue;
        for (int64_t column = 0; column < n_columns; column++)
            if (bright[column]) {
                if (n < n_at_most) {
                    places[n] = (int32_t)(row * n_columns + column);
                    limits[n] = mean[column] + above;
                }
                n++;
            }
    }
    *n_places = n;
}

WIDE static void know(int64_t n, const int32_t *restrict count, const double *restrict wanted,
                      const double *restrict mean, uint8_t *restrict known)
{
    for (int64_t column = 0; column < n; column++)
        known[column] = (uint8_t)(((double)count[column] >= wanted[column]) & (mean[column] > 0.0));
}

/* One row: over its mean where that is known and the pixel VALID. */
WIDE static void divide_row(int64_t n, const float *restrict intensity, const double *restrict mean,
                            const uint8_t *restrict known, const uint8_t *restrict mask, float *restrict divided,
                            uint8_t *restrict masked)
{
    for (int64_t column = 0; column < n; column++) {
        const int32_t sure = known[column] != 0, echo = sure & ((mask[column] & VALID) != 0);
        const double ratio = (double)intensity[column] / (echo ? mean[column] : 1.0);
        divided[column] = (float)(echo ? ratio : 0.0);
        masked[column] = (uint8_t)(sure ? mask[column] : mask[column] & ~VALID);
    }
}

/* level, usable (n_rows, n_columns). wanted (n_columns), room, n_room: overwritten. mean, known: out, (n_rows,
 * n_columns), or one row that is overwritten again and again where mean_step is 0. intensity, mask (n_rows, n_columns),
 * or NULL; divided, masked: out, the same. some (n_some): columns; some_mean, some_known (n_rows, n_some): out.
 */
void auv_mcm_waterfall_level(int64_t n_rows, int64_t n_columns, int64_t half_rows, int64_t half_columns,
                             double least_share, const float *restrict level, const uint8_t *restrict usable,
                             double *restrict wanted, double *room, int32_t *n_room, double *restrict mean,
                             uint8_t *restrict known, int64_t mean_step, const float *restrict intensity,
                             const uint8_t *restrict mask, float *restrict divided, uint8_t *restrict masked,
                             int64_t n_some, const int64_t *restrict some, double *restrict some_mean,
                             uint8_t *restrict some_known)
{
    const int64_t pad = half_columns + 1;
    const Box box = empty_box(n_columns, pad, room, n_room);
    int64_t rows_before = 0;
    for (int64_t row = -half_rows; row < n_rows; row++) {
        enter_row(row, n_rows, n_columns, half_rows, pad, level, usable, box);
        if (row < 0)
            continue;
        double *restrict row_mean = mean + row * mean_step;
        uint8_t *restrict row_known = known + row * mean_step;
        box_means(n_columns, pad, box.band, box.per_count, row_mean);
        const int64_t rows = at_most(row + half_rows, n_rows - 1) - (row > half_rows ? row - half_rows : 0) + 1;
        for (int64_t column = 0; rows != rows_before && column < n_columns; column++) {
            const int64_t near = column > half_columns ? column - half_columns : 0;
            const int64_t columns = at_most(column + half_columns, n_columns - 1) - near + 1;
            wanted[column] = least_share * (double)(rows * columns);
            wanted[column] = wanted[column] > 1.0 ? wanted[column] : 1.0;
        }
        rows_before = rows;
        know(n_columns, box.count, wanted, row_mean, row_known);
        if (intensity) {
            const int64_t at = row * n_columns;
            divide_row(n_columns, intensity + at, row_mean, row_known, mask + at, divided + at, masked + at);
        }
        for (int64_t k = 0; k < n_some; k++) {
            some_mean[row * n_some + k] = row_mean[some[k]];
            some_known[row * n_some + k] = row_known[some[k]];
        }
    }
}
