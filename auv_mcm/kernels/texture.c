/* Blocks of pixels and sums over cells of blocks that textures are made of, see texture.py for their definition.
 *
 * Sums go down the rows first and then along the few sums of a cell or block, so that whole rows go through vectors.
 */

#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { VALID = 1, SATURATED = 2 }; /* of records.py */
enum { BEFORE = 1, LAG = 4 };      /* columns and rows that a difference reaches, before and behind */
enum {
    KNOWN,
    ECHO,
    FIRST,
    SECOND,
    THIRD,
    DARK,
    BRIGHT,
    GRAIN_ALONG_COUNT,
    GRAIN_ALONG,
    GRAIN_ACROSS_COUNT,
    GRAIN_ACROSS,
    LAG_ALONG_COUNT,
    LAG_ALONG,
    LAG_ACROSS_COUNT,
    LAG_ACROSS,
    LAG_THIRD,
    TENSOR_ALONG,
    TENSOR_ACROSS,
    TENSOR_BOTH,
    NEAR_COUNT,
    NEAR,
    NEAR_THIRD,
    CONTRAST,
    LIKENESS,
    MAPS
};

/* Adds a row of pixels to the sums of a row of blocks. echo (width + lag), zeros beyond the first n: overwritten. */
WIDE static void add_pixels(int64_t n, int64_t width, int64_t lag, const float *restrict intensity,
                            const uint8_t *restrict mask, float most, float *restrict echo, float *restrict sums)
{
    float *restrict total = sums, *restrict share = sums + width, *restrict square = sums + 2 * width;
    float *restrict product = sums + 3 * width;
    for (int64_t i = 0; i < n; i++) {
        const float usable = (float)((mask[i] & (VALID | SATURATED)) == VALID);
        echo[i] = (intensity[i] < most ? intensity[i] : most) * usable;
        share[i] += usable;
    }
    for (int64_t i = 0; i < n; i++) {
        total[i] += echo[i];
        square[i] += echo[i] * echo[i];
        product[i] += echo[i] * echo[i + lag];
    }
}

/* intensity, mask (n_rows, n_columns): pixels from row `first` on, which may lie outside, make n_down by n_across
 * blocks. sums (4, n_across * block_columns) and echo (n_across * block_columns + lag): overwritten. planes (4, n_down,
 * n_across + 2 margin): zeros, out. Mean, whether known, mean square, mean product with the pixel `lag` farther out.
 */
void auv_mcm_texture_blocks(int64_t n_rows, int64_t n_columns, int64_t first, int64_t n_down, int64_t n_across,
                            int64_t block_rows, int64_t block_columns, int64_t lag, int64_t margin, float most,
                            const float *restrict intensity, const uint8_t *restrict mask, float *restrict sums,
                            float *restrict echo, float *restrict planes)
{
    const int64_t width = n_across * block_columns, stride = n_across + 2 * margin, size = n_down * stride;
    const float area = (float)(block_rows * block_columns);
    memset(echo, 0, (size_t)(width + lag) * sizeof *echo);
    for (int64_t down = 0; down < n_down; down++) {
        memset(sums, 0, (size_t)(4 * width) * sizeof *sums);
        for (int64_t row = first + down * block_rows; row < first + (down + 1) * block_rows; row++)
            if (row >= 0 && row < n_rows)
                add_pixels(n_columns, width, lag, intensity + row * n_columns, mask + row * n_columns, most, echo,
                           sums);
        float *restrict out = planes + down * stride + margin;
        for (int64_t across = 0; across < n_across; across++) {
            float mean[4];
            for (int64_t plane = 0; plane < 4; plane++) {
                const float *restrict from = sums + plane * width + across * block_columns;
                float sum = from[0];
                for (int64_t k = 1; k < block_columns; k++)
                    sum += from[k];
                mean[plane] = sum / area;
            }
            const int known = mean[1] >= 0.5f;
            const float whole = mean[1] > 0.5f ? mean[1] : 0.5f;
            out[across] = known ? mean[0] / whole : 0.0f;
            out[size + across] = (float)known;
            out[2 * size + across] = known ? mean[2] / whole : 0.0f;
            out[3 * size + across] = known ? mean[3] / whole : 0.0f;
        }
    }
}

/* What one row of blocks adds. level, known: of rows before, here, one behind and LAG behind, with BEFORE zeros before
 * and LAG zeros behind. sums (MAPS, n): adds to it. */
WIDE static void add_blocks(int64_t n, const float *const *level, const float *const *known, const float *restrict echo,
                            const float *restrict square, const float *restrict product, const float *restrict limits,
                            float *restrict sums)
{
    const float *restrict l_before = level[0], *restrict l = level[1], *restrict l_next = level[2],
                *restrict l_far = level[3];
    const float *restrict k_before = known[0], *restrict k = known[1], *restrict k_next = known[2],
                *restrict k_far = known[3];
    const float dark = limits[0], bright = limits[1], dim = limits[2], most = limits[3], along_m = limits[4],
                across_m = limits[5];
#define ADD(MAP, VALUE) sums[MAP * n + i] += (VALUE)
    for (int64_t i = 0; i < n; i++) {
        const float squared = l[i] * l[i];
        ADD(KNOWN, k[i]);
        ADD(ECHO, echo[i]);
        ADD(FIRST, l[i]);
        ADD(SECOND, squared);
        ADD(THIRD, squared * l[i]);
        ADD(DARK, (float)(echo[i] < dark) * k[i]);
        ADD(BRIGHT, (float)(echo[i] > bright) * k[i]);
    }
    for (int64_t i = 0; i < n; i++) {
        const float along = k[i] * k_next[i], across = k[i] * k[i + 1];
        const float down = (l_next[i] - l[i]) * along, right = (l[i + 1] - l[i]) * across;
        ADD(GRAIN_ALONG_COUNT, along);
        ADD(GRAIN_ALONG, down * down);
        ADD(GRAIN_ACROSS_COUNT, across);
        ADD(GRAIN_ACROSS, right * right);
    }
    for (int64_t i = 0; i < n; i++) {
        const float along = k[i] * k_far[i], across = k[i] * k[i + LAG];
        const float down = (l_far[i] - l[i]) * along, right = (l[i + LAG] - l[i]) * across, squared = right * right;
        ADD(LAG_ALONG_COUNT, along);
        ADD(LAG_ALONG, down * down);
        ADD(LAG_ACROSS_COUNT, across);
        ADD(LAG_ACROSS, squared);
        ADD(LAG_THIRD, squared * right);
    }
    for (int64_t i = 0; i < n; i++) {
        const float both = k[i] * k[i + 2], right = (l[i + 2] - l[i]) * both;
        ADD(NEAR_COUNT, both);
        ADD(NEAR, right * right);
        ADD(NEAR_THIRD, right * right * right);
    }
    for (int64_t i = 0; i < n; i++) {
        const float along = (l_next[i] - l_before[i]) * k_next[i] * k_before[i] / along_m;
        const float across = (l[i + 1] - l[i - 1]) * k[i + 1] * k[i - 1] / across_m;
        ADD(TENSOR_ALONG, along * along);
        ADD(TENSOR_ACROSS, across * across);
        ADD(TENSOR_BOTH, along * across);
    }
    for (int64_t i = 0; i < n; i++) {
        const float level_there = echo[i] > dim ? echo[i] : dim, mean = level_there * level_there;
        float contrast = square[i] / mean - 1.0f, likeness = product[i] / mean - 1.0f;
        contrast = contrast < -1.0f ? -1.0f : contrast;
        contrast = contrast > most ? most : contrast;
        likeness = likeness < -1.0f ? -1.0f : likeness;
        likeness = likeness > most ? most : likeness;
        ADD(CONTRAST, contrast * k[i]);
        ADD(LIKENESS, likeness * k[i]);
    }
#undef ADD
}

/* planes (4, n_rows, n_columns) of auv_mcm_texture_blocks, level (n_rows, n_columns); rows and columns: a multiple of
 * cell. limits (6): dark, bright, dim, the most that is measured inside blocks, sides of a block along and across. room
 * (8, BEFORE + n_columns + LAG) zeros and sums (MAPS, n_columns): overwritten. out (MAPS, cells down, cells across).
 */
void auv_mcm_texture_cells(int64_t n_rows, int64_t n_columns, int64_t cell, const float *restrict planes,
                           const float *restrict level, const float *restrict limits, float *restrict room,
                           float *restrict sums, float *restrict out)
{
    static const int64_t reach[4] = {-BEFORE, 0, 1, LAG};
    const int64_t size = n_rows * n_columns, wide = BEFORE + n_columns + LAG, across = n_columns / cell;
    const int64_t each = n_rows / cell * across;
    const size_t bytes = (size_t)n_columns * sizeof *level;
    const float *levels[4], *known[4];
    for (int64_t k = 0; k < 4; k++) {
        levels[k] = room + 2 * k * wide + BEFORE;
        known[k] = room + (2 * k + 1) * wide + BEFORE;
    }
    memset(sums, 0, (size_t)MAPS * bytes);
    for (int64_t row = 0; row < n_rows; row++) {
        for (int64_t k = 0; k < 4; k++) {
            const int64_t from = row + reach[k];
            float *restrict to = room + 2 * k * wide + BEFORE;
            if (from < 0 || from >= n_rows) {
                memset(to, 0, bytes);
                memset(to + wide, 0, bytes);
            } else {
                memcpy(to, level + from * n_columns, bytes);
                memcpy(to + wide, planes + size + from * n_columns, bytes);
            }
        }
        const int64_t at = row * n_columns;
        add_blocks(n_columns, levels, known, planes + at, planes + 2 * size + at, planes + 3 * size + at, limits, sums);
        if ((row + 1) % cell)
            continue;
        for (int64_t map = 0; map < MAPS; map++) {
            float *restrict to = out + map * each + row / cell * across;
            const float *restrict from = sums + map * n_columns;
            for (int64_t i = 0; i < across; i++) {
                float sum = from[i * cell];
                for (int64_t k = 1; k < cell; k++)
                    sum += from[i * cell + k];
                to[i] = sum;
            }
        }
        memset(sums, 0, (size_t)MAPS * bytes);
    }
}
