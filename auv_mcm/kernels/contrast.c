/* Box sums, background and variances that contrasts are made of, and where a box may stand out, see contrast.py for
 * their definition.
 *
 * Sums run along rows and then down, in the order of a running integral image, so that numpy's cumulative sums give the
 * same bits. Boxes are half-open offsets from a pixel, first and last row, first and last column, and are clipped at
 * the tile's edge.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { TOP, BOTTOM, LEFT, RIGHT, SIDES };
enum { CHUNK = 8, PLANES = 3, TOGETHER = 4 };

static inline int64_t within(int64_t value, int64_t last) { return value < 0 ? 0 : value > last ? last : value; }

/* Differences of two rows of an integral image, with what stands at its edges repeated `pad` times on either side. */
#define BAND(NAME, TYPE)                                                                                        \
    static inline void NAME##_between(int64_t n_columns, const TYPE *restrict upper, const TYPE *restrict lower, \
                                      int64_t pad, TYPE *restrict band)                                         \
    {                                                                                                           \
        for (int64_t column = 0; column <= n_columns; column++)                                                 \
            band[pad + column] = lower[column] - upper[column];                                                 \
        for (int64_t column = 0; column < pad; column++) {                                                      \
            band[column] = band[pad];                                                                           \
            band[pad + n_columns + 1 + column] = band[pad + n_columns];                                         \
        }                                                                                                       \
    }                                                                                                           \
    static inline void NAME(int64_t n_rows, int64_t n_columns, const TYPE *restrict sums, int64_t top,          \
                            int64_t bottom, int64_t pad, TYPE *restrict band)                                   \
    {                                                                                                           \
        NAME##_between(n_columns, sums + within(top, n_rows) * (n_columns + 1),                                 \
                       sums + within(bottom, n_rows) * (n_columns + 1), pad, band);                             \
    }

BAND(band_of_sums, double)
BAND(band_of_counts, int32_t)

/* Adds rows of pixels whose bits under `tested` are VALID alone, bounded by `most`, to the integral images' row above.
 * sums, counts: out, a row each. Rows go together since each sum waits for the one before.
 */
static inline void add_rows(int64_t n, int64_t n_columns, const float *restrict intensity, const uint8_t *restrict mask,
                            int32_t tested, int32_t valid, float most, const double *above, const int32_t *count_above,
                            double *const *sums, int32_t *const *counts)
{
    double total[TOGETHER] = {0.0};
    int32_t count[TOGETHER] = {0};
    for (int64_t row = 0; row < n; row++) {
        sums[row][0] = 0.0;
        counts[row][0] = 0;
    }
    for (int64_t column = 0; column < n_columns; column++) {
        double sum = above[column + 1];
        int32_t number = count_above[column + 1];
        for (int64_t row = 0; row < n; row++) {
            const int64_t at = row * n_columns + column;
            const int32_t inside = (mask[at] & tested) == valid;
            const float bounded = intensity[at] > most ? most : intensity[at];
            total[row] += inside ? bounded : 0.0f;
            count[row] += inside;
            sums[row][column + 1] = sum = sum + total[row];
            counts[row][column + 1] = number = number + count[row];
        }
    }
}

/* intensity, mask (n_rows, n_columns). sums, counts (n_rows + 1, n_columns + 1): out, integral images of intensity
 * bounded by `most` and of the number of valid pixels.
 */
void auv_mcm_contrast_sums(int64_t n_rows, int64_t n_columns, const float *restrict intensity,
                           const uint8_t *restrict mask, int32_t valid, float most, double *sums, int32_t *counts)
{
    const int64_t stride = n_columns + 1;
    memset(sums, 0, (size_t)stride * sizeof *sums);
    memset(counts, 0, (size_t)stride * sizeof *counts);
    for (int64_t row = 0; row < n_rows;) {
        double *to[TOGETHER];
        int32_t *count_to[TOGETHER];
        for (int64_t k = 0; k < TOGETHER; k++) {
            to[k] = sums + (row + k + 1) * stride;
            count_to[k] = counts + (row + k + 1) * stride;
        }
        const double *above = sums + row * stride;
        const int32_t *count_above = counts + row * stride;
        const float *from = intensity + row * n_columns;
        const uint8_t *bits = mask + row * n_columns;
        if (n_rows - row >= TOGETHER) {
            add_rows(TOGETHER, n_columns, from, bits, valid, valid, most, above, count_above, to, count_to);
            row += TOGETHER;
        } else {
            add_rows(1, n_columns, from, bits, valid, valid, most, above, count_above, to, count_to);
            row++;
        }
    }
}

/* intensity, mask (n_rows, n_columns): the sea floor is what is valid and not saturated, bounded by `most`. sums,
 * counts (depth, n_columns + 1): overwritten, the integral images' rows that frame and hollow reach from a row, one
 * more than they are high, row r at r modulo depth. band (2, n_columns + 1 + 2 pad), count_band: overwritten.
 * background, known (n_rows, n_columns): out.
 */
WIDE void auv_mcm_contrast_background(int64_t n_rows, int64_t n_columns, const float *restrict intensity,
                                      const uint8_t *restrict mask, int32_t valid, int32_t saturated, float most,
                                      const int32_t *restrict frame, const int32_t *restrict hollow, double least_count,
                                      double least_mean, int64_t pad, int64_t depth, double *sums, int32_t *counts,
                                      double *restrict band, int32_t *restrict count_band, float *restrict background,
                                      uint8_t *restrict known)
{
    const int64_t width = n_columns + 1 + 2 * pad, stride = n_columns + 1;
    const int64_t ahead = frame[BOTTOM] > hollow[BOTTOM] ? frame[BOTTOM] : hollow[BOTTOM];
    const float silent = (float)least_mean;
    int64_t n_added = 0;
    memset(sums, 0, (size_t)stride * sizeof *sums);
    memset(counts, 0, (size_t)stride * sizeof *counts);
    for (int64_t row = 0; row < n_rows; row++) {
        for (; n_added < n_rows && n_added < row + ahead; n_added++) {
            double *to = sums + (n_added + 1) % depth * stride;
            int32_t *count_to = counts + (n_added + 1) % depth * stride;
            add_rows(1, n_columns, intensity + n_added * n_columns, mask + n_added * n_columns, valid | saturated,
                     valid, most, sums + n_added % depth * stride, counts + n_added % depth * stride, &to, &count_to);
        }
        for (int64_t k = 0; k < 2; k++) {
            const int32_t *box = k ? hollow : frame;
            const int64_t top = within(row + box[TOP], n_rows) % depth * stride;
            const int64_t bottom = within(row + box[BOTTOM], n_rows) % depth * stride;
            band_of_sums_between(n_columns, sums + top, sums + bottom, pad, band + k * width);
            band_of_counts_between(n_columns, counts + top, counts + bottom, pad, count_band + k * width);
        }
        const double *restrict far = band + pad + frame[RIGHT], *restrict near = band + pad + frame[LEFT];
        const double *restrict inner_far = band + width + pad + hollow[RIGHT], *restrict inner_near = band + width +
                                                                                                      pad +
                                                                                                      hollow[LEFT];
        const int32_t *restrict n_far = count_band + pad + frame[RIGHT], *restrict n_near = count_band + pad +
                                                                                            frame[LEFT];
        const int32_t *restrict n_inner_far = count_band + width + pad + hollow[RIGHT];
        const int32_t *restrict n_inner_near = count_band + width + pad + hollow[LEFT];
        float *restrict mean_out = background + row * n_columns;
        uint8_t *restrict known_out = known + row * n_columns;
        const uint8_t *restrict bits = mask + row * n_columns;
        for (int64_t column = 0; column < n_columns; column++) {
            double total = (far[column] - near[column]) - (inner_far[column] - inner_near[column]);
            const double count = (double)((n_far[column] - n_near[column]) -
                                          (n_inner_far[column] - n_inner_near[column]));
            total = total > 0.0 ? total : 0.0;
            double mean = total / (count > 1.0 ? count : 1.0);
            mean = mean > least_mean ? mean : least_mean;
            mean_out[column] = (float)mean;
            known_out[column] = (uint8_t)((count >= least_count) & ((float)mean > silent) &
                                          ((bits[column] & valid) != 0));
        }
    }
}

/* boxes (n_boxes, SIDES). ratios (n_boxes, n_rows, n_columns): out. band, count_band (n_columns + 1 + 2 pad):
 * overwritten. */
WIDE void auv_mcm_contrast_ratios(int64_t n_rows, int64_t n_columns, const double *restrict sums,
                                  const int32_t *restrict counts, const float *restrict background, int64_t n_boxes,
                                  const int32_t *restrict boxes, float least, int64_t pad, double *restrict band,
                                  int32_t *restrict count_band, float *restrict ratios)
{
    for (int64_t row = 0; row < n_rows; row++)
        for (int64_t k = 0; k < n_boxes; k++) {
            const int32_t *box = boxes + k * SIDES;
            band_of_sums(n_rows, n_columns, sums, row + box[TOP], row + box[BOTTOM], pad, band);
            band_of_counts(n_rows, n_columns, counts, row + box[TOP], row + box[BOTTOM], pad, count_band);
            const double *restrict far = band + pad + box[RIGHT], *restrict near = band + pad + box[LEFT];
            const int32_t *restrict n_far = count_band + pad + box[RIGHT], *restrict n_near = count_band + pad +
                                                                                              box[LEFT];
            const float *restrict level = background + row * n_columns;
            float *restrict out = ratios + (k * n_rows + row) * n_columns;
            for (int64_t column = 0; column < n_columns; column++) {
                const double count = (double)(n_far[column] - n_near[column]);
                const float mean = (float)((far[column] - near[column]) / (count > 1.0 ? count : 1.0));
                const float ratio = mean / level[column];
                out[column] = ratio > least ? ratio : least;
            }
        }
}

/* Adds the running sums of a row's values, clipped and 0 where not known, and of their squares to what stands in
 * `total`, by plane first the sums and then the squares. The planes go together since each sum waits for the one
 * before.
 */
static inline void add_along(int64_t n_columns, int64_t step, const float *restrict values,
                             const uint8_t *restrict known, float clip, double *restrict total, int32_t *restrict n,
                             int32_t sign)
{
    const int64_t width = n_columns + 1;
    double sum[PLANES] = {0.0}, square_sum[PLANES] = {0.0};
    int32_t count = 0;
    for (int64_t column = 0; column < n_columns; column++) {
        const float sure = (float)known[column];
        for (int plane = 0; plane < PLANES; plane++) {
            float value = values[plane * step + column];
            value = value < -clip ? -clip : value;
            value = value > clip ? clip : value;
            value *= sure;
            sum[plane] += value;
            square_sum[plane] += value * value;
            total[2 * plane * width + column + 1] += sum[plane];
            total[(2 * plane + 1) * width + column + 1] += square_sum[plane];
        }
        n[column + 1] += sign * (count += known[column]);
    }
}

/* values (PLANES, n_rows, n_columns), known (n_rows, n_columns). sums (6 PLANES, n_columns + 1), n_known (n_columns +
 * 1): zeros, overwritten. variance (PLANES, n_rows, n_columns): out, rows [first, last). Sums above and below the box's
 * rows go down the tile with them, from its first row on.
 */
WIDE void auv_mcm_contrast_variances(int64_t n_rows, int64_t n_columns, int64_t first, int64_t last,
                                     const float *restrict values, const uint8_t *restrict known, int64_t half_rows,
                                     int64_t half_columns, float clip, double least, double *restrict sums,
                                     int32_t *restrict n_known, float *restrict variance)
{
    const int64_t width = n_columns + 1, size = n_rows * n_columns, n_sums = 2 * PLANES * width;
    double *restrict lower = sums, *restrict upper = sums + n_sums, *restrict band = sums + 2 * n_sums;
    for (int64_t row = -half_rows; row < last; row++) {
        const int64_t joins = (row + half_rows) * n_columns, leaves = (row - half_rows - 1) * n_columns;
        if (joins < size)
            add_along(n_columns, size, values + joins, known + joins, clip, lower, n_known, 1);
        if (leaves >= 0)
            add_along(n_columns, size, values + leaves, known + leaves, clip, upper, n_known, -1);
        if (row < first)
            continue;
        for (int64_t i = 0; i < n_sums; i++)
            band[i] = lower[i] - upper[i];
        const int64_t begin = half_columns < n_columns ? half_columns : n_columns;
        const int64_t end = n_columns - half_columns > begin ? n_columns - half_columns : begin;
        for (int plane = 0; plane < PLANES; plane++) {
            const double *restrict total = band + 2 * plane * width, *restrict squares = total + width;
            float *restrict out = variance + plane * size + row * n_columns;
#define VARIANCE(FAR, NEAR)                                                        \
    {                                                                              \
        const int32_t inside = n_known[FAR] - n_known[NEAR];                       \
        const double count = (double)(inside > 1 ? inside : 1);                    \
        const double mean = (total[FAR] - total[NEAR]) / count;                    \
        const double value = (squares[FAR] - squares[NEAR]) / count - mean * mean; \
        out[column] = (float)(value > least ? value : least);                      \
    }
            for (int64_t column = 0; column < begin; column++)
                VARIANCE(within(column + half_columns + 1, n_columns), 0)
            for (int64_t column = begin; column < end; column++)
                VARIANCE(column + half_columns + 1, column - half_columns)
            for (int64_t column = end; column < n_columns; column++)
                VARIANCE(n_columns, within(column - half_columns, n_columns))
#undef VARIANCE
        }
    }
}

/* Appends the places whose flag is set and clears the flags. flags: a multiple of CHUNK long, zeros beyond n. */
static int64_t collect(int64_t n, uint8_t *restrict flags, int32_t place, int32_t *restrict places)
{
    int64_t found = 0;
    for (int64_t chunk = 0; chunk < n; chunk += CHUNK) {
        uint64_t any;
        memcpy(&any, flags + chunk, CHUNK);
        if (!any)
            continue;
        for (int64_t i = chunk; i < chunk + CHUNK; i++) {
            places[found] = place + (int32_t)i;
            found += flags[i];
        }
        memset(flags + chunk, 0, CHUNK);
    }
    return found;
}

/* For each box the pixels of rows [first, last) around which its sum reaches its block's limit times background and
 * valid pixels.
 *
 * boxes (n_boxes, SIDES), limits (n_boxes, blocks of rows, blocks of columns). flags (n_columns, and CHUNK more):
 * zeros. places (n_boxes, room): out, n_places (n_boxes): how many.
 */
WIDE void auv_mcm_contrast_bright(int64_t n_rows, int64_t n_columns, int64_t first, int64_t last,
                                  const double *restrict sums, const int32_t *restrict counts,
                                  const float *restrict background, const uint8_t *restrict known, int64_t n_boxes,
                                  const int32_t *restrict boxes, const double *restrict limits, int64_t block_rows,
                                  int64_t block_columns, int64_t pad, int64_t room, double *restrict band,
                                  int32_t *restrict count_band, uint8_t *restrict flags, int32_t *restrict places,
                                  int64_t *restrict n_places)
{
    const int64_t n_blocks = (n_columns + block_columns - 1) / block_columns;
    const int64_t blocks_each = (n_rows + block_rows - 1) / block_rows * n_blocks;
    memset(n_places, 0, (size_t)n_boxes * sizeof *n_places);
    for (int64_t row = first; row < last; row++) {
        const float *restrict level = background + row * n_columns;
        const uint8_t *restrict sure = known + row * n_columns;
        for (int64_t k = 0; k < n_boxes; k++) {
            const int32_t *box = boxes + k * SIDES;
            if (k == 0 || box[TOP] != box[TOP - SIDES] || box[BOTTOM] != box[BOTTOM - SIDES]) {
                band_of_sums(n_rows, n_columns, sums, row + box[TOP], row + box[BOTTOM], pad, band);
                band_of_counts(n_rows, n_columns, counts, row + box[TOP], row + box[BOTTOM], pad, count_band);
            }
            const double *restrict far = band + pad + box[RIGHT], *restrict near = band + pad + box[LEFT];
            const int32_t *restrict n_far = count_band + pad + box[RIGHT], *restrict n_near = count_band + pad +
                                                                                              box[LEFT];
            const int32_t tall = box[BOTTOM] - box[TOP], wide = box[RIGHT] - box[LEFT], full = tall * wide;
            const double *restrict limit = limits + k * blocks_each + row / block_rows * n_blocks;
            for (int64_t block = 0; block < n_blocks; block++) {
                const double bound = limit[block];
                const int64_t begin = block * block_columns, end = within(begin + block_columns, n_columns);
                if (n_far[end - 1] - n_near[begin] == tall * (int32_t)(end - 1 - begin + wide))
                    for (int64_t column = begin; column < end; column++) /* nothing is missing anywhere */
                        flags[column] = (uint8_t)((far[column] - near[column] >=
                                                   bound * (double)level[column] * (double)full) &
                                                  sure[column]);
                else
                    for (int64_t column = begin; column < end; column++) {
                        const double least = bound * (double)level[column] * (double)(n_far[column] - n_near[column]);
                        flags[column] = (uint8_t)((far[column] - near[column] >= least) & sure[column]);
                    }
            }
            n_places[k] += collect(n_columns, flags, (int32_t)(row * n_columns), places + k * room + n_places[k]);
        }
    }
}

/* The length in columns of the shadow at a column; see shadow_columns of contrast.py. */
static inline int64_t shadow_columns(int64_t column, double height_m, double clearance_m, double column_m,
                                     double least_m, double most_m)
{
    double length_m = height_m * (((double)column + 0.5) * column_m) / clearance_m;
    length_m = length_m < least_m ? least_m : length_m;
    length_m = length_m > most_m ? most_m : length_m;
    /* In numbers of 2^52 and more nothing is left of fractions: nearest, halves to even. */
    const double whole = (length_m / column_m + 6755399441055744.0) - 6755399441055744.0;
    return whole > 1.0 ? (int64_t)whole : 1;
}

/* Lengths of shadows never fall with the column, so that a row is a few runs of equal length. runs: out, the shortest
 * length, and where the runs of this and of each longer one end.
 */
static void shadow_runs(int64_t n_columns, double height_m, double clear_m, double column_m, double least_m,
                        double most_m, int32_t *restrict runs)
{
    const double columns_per_length = clear_m / height_m;
    const int64_t longest = shadow_columns(n_columns - 1, height_m, clear_m, column_m, least_m, most_m);
    int64_t length = shadow_columns(0, height_m, clear_m, column_m, least_m, most_m);
    *runs++ = (int32_t)length;
    for (int64_t begin = 0; begin < n_columns; length++) {
        int64_t end = n_columns;
        if (length < longest) {
            const double guess = ((double)length + 0.5) * columns_per_length - 0.5;
            end = guess < (double)n_columns ? (int64_t)guess + 1 : n_columns;
            end = end < begin ? begin : end;
            while (end > begin && shadow_columns(end - 1, height_m, clear_m, column_m, least_m, most_m) > length)
                end--;
            while (end < n_columns && shadow_columns(end, height_m, clear_m, column_m, least_m, most_m) <= length)
                end++;
        }
        *runs++ = (int32_t)end;
        begin = end;
    }
}

/* One height's shadow in a row, whose band of sums begins at `sums`: flags where it is at most its block's limit times
 * background and valid pixels, which are more than least_share of it. runs: of shadow_runs.
 */
static inline void flag_dark(int64_t n_columns, const double *restrict sums, const int32_t *restrict counts,
                             const float *restrict level, int64_t half_rows, float least_share,
                             const int32_t *restrict runs, const double *restrict limit, int64_t block_columns,
                             uint8_t *restrict flags)
{
    int64_t length = *runs++;
    for (int64_t begin = 0; begin < n_columns; length++) {
        const int64_t end = *runs++;
        const int32_t n_rows = (int32_t)(2 * half_rows + 1), full = n_rows * (int32_t)length;
        const int32_t least_count = (int32_t)(least_share * (float)full);
        const double *restrict far = sums + length;
        const int32_t *restrict n_far = counts + length;
        while (begin < end) {
            const int64_t block = begin / block_columns, next = (block + 1) * block_columns,
                          stop = next < end ? next : end;
            const double bound = limit[block];
            if (full > least_count && n_far[stop - 1] - counts[begin] == n_rows * (int32_t)(stop - 1 + length - begin))
                for (int64_t column = begin; column < stop; column++) /* nothing is missing anywhere */
                    flags[column] = (uint8_t)(far[column] - sums[column] <=
                                              bound * (double)level[column] * (double)full);
            else
                for (int64_t column = begin; column < stop; column++) {
                    const int32_t count = n_far[column] - counts[column];
                    flags[column] = (uint8_t)((far[column] - sums[column] <=
                                               bound * (double)level[column] * (double)count) &
                                              (count > least_count));
                }
            begin = stop;
        }
    }
}

/* For each height the pixels of rows [first, last) from which on its shadow's sum is low enough, see flag_dark.
 *
 * half_rows, height_m (n_heights), clearance_m (n_heights, n_rows): what the height's grazing ray has below it, the
 * same in rows that follow each other as a rule. runs (n_heights, pad + 1): overwritten; no shadow is longer than pad.
 * The rest as in auv_mcm_contrast_bright.
 */
WIDE void auv_mcm_contrast_dark(int64_t n_rows, int64_t n_columns, int64_t first, int64_t last,
                                const double *restrict sums, const int32_t *restrict counts,
                                const float *restrict background, int64_t n_heights, const int64_t *restrict half_rows,
                                const double *restrict height_m, const double *restrict clearance_m, float least_share,
                                double column_m, double least_m, double most_m, const double *restrict limits,
                                int64_t block_rows, int64_t block_columns, int64_t pad, int64_t room,
                                double *restrict band, int32_t *restrict count_band, int32_t *restrict runs,
                                uint8_t *restrict flags, int32_t *restrict places, int64_t *restrict n_places)
{
    const int64_t n_blocks = (n_columns + block_columns - 1) / block_columns;
    const int64_t blocks_each = (n_rows + block_rows - 1) / block_rows * n_blocks;
    memset(n_places, 0, (size_t)n_heights * sizeof *n_places);
    for (int64_t row = first; row < last; row++)
        for (int64_t k = 0; k < n_heights; k++) {
            const int64_t half = half_rows[k];
            if (k == 0 || half != half_rows[k - 1]) {
                band_of_sums(n_rows, n_columns, sums, row - half, row + half + 1, pad, band);
                band_of_counts(n_rows, n_columns, counts, row - half, row + half + 1, pad, count_band);
            }
            const double *clear_m = clearance_m + k * n_rows + row;
            int32_t *own_runs = runs + k * (pad + 1);
            if (row == first || clear_m[0] != clear_m[-1])
                shadow_runs(n_columns, height_m[k], *clear_m, column_m, least_m, most_m, own_runs);
            flag_dark(n_columns, band + pad, count_band + pad, background + row * n_columns, half, least_share,
                      own_runs, limits + k * blocks_each + row / block_rows * n_blocks, block_columns, flags);
            n_places[k] += collect(n_columns, flags, (int32_t)(row * n_columns), places + k * room + n_places[k]);
        }
}

/* places (n), deviates (n): of shadows that start there. darkest (n_rows, n_columns): in and out, raised to minus the
 * deviate where such a shadow starts 1 to `lag` columns behind, in the row or one beside it, of rows [first, last).
 */
void auv_mcm_contrast_before(int64_t n_columns, int64_t first, int64_t last, int64_t n, const int32_t *restrict places,
                             const float *restrict deviates, int64_t lag, float *restrict darkest)
{
    for (int64_t i = 0; i < n; i++) {
        const int64_t row = places[i] / n_columns, column = places[i] % n_columns;
        const int64_t top = row > first ? row - 1 : first, bottom = row + 1 < last ? row + 1 : last - 1;
        const float dark = -deviates[i];
        for (int64_t at = top; at <= bottom; at++)
            for (int64_t before = column > lag ? column - lag : 0; before < column; before++) {
                float *const here = darkest + at * n_columns + before;
                *here = dark > *here ? dark : *here;
            }
    }
}

/* places (n), boxes (n, SIDES): means and numbers of valid pixels (n) of the boxes around these pixels. */
void auv_mcm_contrast_means(int64_t n_rows, int64_t n_columns, const double *restrict sums,
                            const int32_t *restrict counts, int64_t n, const int32_t *restrict places,
                            const int32_t *restrict boxes, float *restrict mean, int32_t *restrict count)
{
    const int64_t stride = n_columns + 1;
    for (int64_t i = 0; i < n; i++) {
        const int32_t row = places[i] / (int32_t)n_columns, column = places[i] % (int32_t)n_columns;
        const int32_t *box = boxes + i * SIDES;
        const int64_t top = within(row + box[TOP], n_rows) * stride,
                      bottom = within(row + box[BOTTOM], n_rows) * stride;
        const int64_t left = within(column + box[LEFT], n_columns), right = within(column + box[RIGHT], n_columns);
        const double total = (sums[bottom + right] - sums[top + right]) - (sums[bottom + left] - sums[top + left]);
        const int32_t number = (counts[bottom + right] - counts[top + right]) -
                               (counts[bottom + left] - counts[top + left]);
        mean[i] = (float)(total / (double)(number > 1 ? number : 1));
        count[i] = number;
    }
}

/* Pixels of rows [first, last) above -infinity than which none within half_rows and half_columns is higher. places:
 * out. */
void auv_mcm_contrast_peaks(int64_t n_rows, int64_t n_columns, int64_t first, int64_t last, const float *restrict plane,
                            int64_t half_rows, int64_t half_columns, int32_t *restrict places,
                            int64_t *restrict n_places)
{
    int64_t n = 0;
    for (int64_t row = first; row < last; row++) {
        const int64_t top = within(row - half_rows, n_rows - 1), bottom = within(row + half_rows, n_rows - 1);
        for (int64_t column = 0; column < n_columns; column++) {
            const float value = plane[row * n_columns + column];
            if (!(value > -INFINITY))
                continue;
            const int64_t left = within(column - half_columns, n_columns - 1),
                          right = within(column + half_columns, n_columns - 1);
            int32_t higher = 0;
            for (int64_t i = top; i <= bottom && !higher; i++)
                for (int64_t j = left; j <= right; j++)
                    higher |= plane[i * n_columns + j] > value;
            if (!higher)
                places[n++] = (int32_t)(row * n_columns + column);
        }
    }
    *n_places = n;
}
