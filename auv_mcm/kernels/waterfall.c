/* What every ping and every row of a waterfall goes through, see waterfall.py for its definition.
 *
 * Nothing but sums, products and quotients in numpy's order, so that numpy gives the same bits; logarithms,
 * exponentials and angles, which no two libraries round alike, are left to numpy.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { ROWS_TOGETHER = 4 };
enum { VALID = 1, SATURATED = 2, LOW_RESOLUTION = 4, TURN = 8 }; /* of records.py */

static inline int64_t at_most(int64_t value, int64_t last) { return value < last ? value : last; }

/* values (n_rows, n_columns). sums (n_rows, n_columns + 1): out, less the sum from each column to the last. Rows go
 * together since each sum waits for the one before.
 */
void auv_mcm_waterfall_sums(int64_t n_rows, int64_t n_columns, const float *restrict values, double *restrict sums)
{
    for (int64_t first = 0; first < n_rows; first += ROWS_TOGETHER) {
        const int64_t rows = at_most(ROWS_TOGETHER, n_rows - first), stride = n_columns + 1;
        const float *from[ROWS_TOGETHER];
        double *to[ROWS_TOGETHER], total[ROWS_TOGETHER] = {0.0};
        for (int64_t k = 0; k < ROWS_TOGETHER; k++) { /* a row too few is added up again */
            const int64_t row = first + at_most(k, rows - 1);
            from[k] = values + row * n_columns;
            to[k] = sums + row * stride;
            to[k][n_columns] = -0.0;
        }
        for (int64_t column = n_columns - 1; column >= 0; column--)
            for (int64_t k = 0; k < ROWS_TOGETHER; k++) {
                total[k] += from[k][column];
                to[k][column] = -total[k];
            }
    }
}

/* counts (n_rows, n_columns) of one or two bytes each; intensity: of every count. sums (n_rows, n_columns + 1): out, as
 * above. */
#define COUNT_SUMS(NAME, COUNT)                                                                                 \
    void NAME(int64_t n_rows, int64_t n_columns, const COUNT *restrict counts, const float *restrict intensity, \
              double *restrict sums)                                                                            \
    {                                                                                                           \
        for (int64_t first = 0; first < n_rows; first += ROWS_TOGETHER) {                                       \
            const int64_t rows = at_most(ROWS_TOGETHER, n_rows - first), stride = n_columns + 1;                \
            const COUNT *from[ROWS_TOGETHER];                                                                   \
            double *to[ROWS_TOGETHER], total[ROWS_TOGETHER] = {0.0};                                            \
            for (int64_t k = 0; k < ROWS_TOGETHER; k++) {                                                       \
                const int64_t row = first + at_most(k, rows - 1);                                               \
                from[k] = counts + row * n_columns;                                                             \
                to[k] = sums + row * stride;                                                                    \
                to[k][n_columns] = -0.0;                                                                        \
            }                                                                                                   \
            for (int64_t column = n_columns - 1; column >= 0; column--)                                         \
                for (int64_t k = 0; k < ROWS_TOGETHER; k++) {                                                   \
                    total[k] += intensity[from[k][column]];                                                     \
                    to[k][column] = -total[k];                                                                  \
                }                                                                                               \
        }                                                                                                       \
    }
COUNT_SUMS(auv_mcm_waterfall_sums_of_bytes, uint8_t)
COUNT_SUMS(auv_mcm_waterfall_sums_of_words, uint16_t)

/* Sums up to edges given in samples, whole part and fraction apart, and from each edge to the next. at (n_edges):
 * overwritten. Not WIDE: two loads are faster than a gather.
 */
static void between(int64_t n_edges, const double *restrict sums, const int32_t *restrict whole,
                    const double *restrict fraction, double *restrict at, double *restrict difference)
{
    for (int64_t edge = 0; edge < n_edges; edge++) {
        const double low = sums[whole[edge]], high = sums[whole[edge] + 1];
        at[edge] = low + fraction[edge] * (high - low);
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++)
        difference[edge] = at[edge + 1] - at[edge];
}

/* One row of edges in samples. width, sampled: from each edge to the next, as wanted and within the samples. */
WIDE static void place_edges(int64_t n_edges, int64_t n_samples, const double *restrict edges, double first,
                             double per_spacing, int32_t *restrict whole, double *restrict fraction,
                             double *restrict width, double *restrict sampled)
{
    const double last = (double)n_samples;
    for (int64_t edge = 0; edge < n_edges; edge++)
        width[edge] = (edges[edge] - first) * per_spacing + 0.5;
    for (int64_t edge = 0; edge < n_edges; edge++) {
        double position = width[edge];
        position = position < 0.0 ? 0.0 : position;
        position = position > last ? last : position;
        const int32_t sample = (int32_t)position,
                      kept = sample < (int32_t)n_samples - 1 ? sample : (int32_t)n_samples - 1;
        whole[edge] = kept;
        fraction[edge] = position - (double)kept;
        sampled[edge] = fraction[edge] + (double)kept;
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++) {
        width[edge] = width[edge + 1] - width[edge];
        sampled[edge] = sampled[edge + 1] - sampled[edge];
    }
}

/* Whether weight covers half of width, and what to divide by: weight, 1 where it does not. */
WIDE static void cover(int64_t n, const double *restrict weight, const double *restrict width, uint8_t *restrict sure,
                       double *restrict divisor)
{
    for (int64_t column = 0; column < n; column++) {
        const int32_t enough = (weight[column] >= 0.5 * width[column]) & (weight[column] > 1e-9);
        divisor[column] = enough ? weight[column] : 1.0;
        sure[column] = (uint8_t)enough;
    }
}

WIDE static void divide(int64_t n, const double *restrict divisor, const uint8_t *restrict sure, double *restrict mean)
{
    for (int64_t column = 0; column < n; column++) {
        const double value = mean[column] / divisor[column];
        mean[column] = sure[column] ? value : 0.0;
    }
}

/* sums (n_pings, n_samples + 1), weights the same or NULL; clipped (n_pings, n_near + 1) or NULL: none is beyond the
 * first n_near samples. edges (any, n_edges); edge_row (n_pings): which of them a ping has. whole (n_edges), scratch
 * (6, n_edges), covered (n_edges): overwritten. intensity, valid, saturated (n_pings, n_edges - 1): out.
 */
void auv_mcm_waterfall_means(int64_t n_pings, int64_t n_samples, int64_t n_edges, const double *restrict sums,
                             const double *restrict weights, const double *restrict clipped, int64_t n_near,
                             double first, double per_spacing, const double *restrict edges,
                             const int64_t *restrict edge_row, int32_t *restrict whole, double *restrict scratch,
                             uint8_t *restrict covered, double *restrict intensity, uint8_t *restrict valid,
                             uint8_t *restrict saturated)
{
    const int64_t n = n_edges - 1;
    double *restrict fraction = scratch, *restrict width = scratch + n_edges, *restrict sampled = scratch + 2 * n_edges;
    double *restrict at = scratch + 3 * n_edges, *restrict weight = scratch + 4 * n_edges,
                     *restrict divisor = scratch + 5 * n_edges;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        double *restrict mean = intensity + ping * n;
        uint8_t *restrict full = saturated + ping * n;
        const int is_new = ping == 0 || edge_row[ping] != edge_row[ping - 1];
        if (is_new) {
            place_edges(n_edges, n_samples, edges + edge_row[ping] * n_edges, first, per_spacing, whole, fraction,
                        width, sampled);
            if (!weights)
                cover(n, sampled, width, covered, divisor);
        }
        if (weights) {
            between(n_edges, weights + ping * (n_samples + 1), whole, fraction, at, weight);
            cover(n, weight, width, covered, divisor);
        }
        between(n_edges, sums + ping * (n_samples + 1), whole, fraction, at, mean);
        divide(n, divisor, covered, mean);
        memcpy(valid + ping * n, covered, (size_t)n);
        memset(full, 0, (size_t)n);
        if (clipped) {
            const double *restrict row = clipped + ping * (n_near + 1), *restrict share = weights ? weight : sampled;
            double before = 0.0;
            for (int64_t edge = 0; edge < n_edges; edge++) {
                const int64_t sample = at_most(whole[edge], n_near), next = at_most((int64_t)whole[edge] + 1, n_near);
                const double here = row[sample] + fraction[edge] * (row[next] - row[sample]);
                if (edge > 0)
                    full[edge - 1] = (uint8_t)((here - before > 0.25 * share[edge - 1]) & covered[edge - 1]);
                before = here;
                if (row[sample] == 0.0)
                    break; /* nothing is clipped from here on */
            }
        }
    }
}

/* values, valid (n_pings, n_bins). total, count (n_bins + 1): overwritten. score (n_pings, n_bins): out, where a step
 * may be, else as is. */
WIDE void auv_mcm_waterfall_steps(int64_t n_pings, int64_t n_bins, const double *restrict values,
                                  const uint8_t *restrict valid, int64_t blank, int64_t window, double least_step,
                                  double twice_variance, double *restrict total, double *restrict count,
                                  double *restrict score)
{
    const int64_t begin = blank + 3, end = n_bins - window;
    const double half = 0.5 * (double)window;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        double sum = 0.0, number = 0.0;
        double *restrict out = score + ping * n_bins;
        total[0] = count[0] = 0.0;
        for (int64_t bin = 0; bin < n_bins; bin++) {
            const int32_t sure = valid[ping * n_bins + bin] != 0;
            total[bin + 1] = sum += sure ? values[ping * n_bins + bin] : 0.0;
            count[bin + 1] = number += (double)sure;
        }
#define STEP(START)                                                                                              \
    {                                                                                                            \
        const double n_after = count[bin + window] - count[bin], n_near = count[bin] - count[START];             \
        const double n_column = count[bin] - count[blank], both = n_near + n_after;                              \
        const double after = (total[bin + window] - total[bin]) / (n_after > 1.0 ? n_after : 1.0);               \
        const double near = (total[bin] - total[START]) / (n_near > 1.0 ? n_near : 1.0);                         \
        const double column = (total[bin] - total[blank]) / (n_column > 1.0 ? n_column : 1.0);                   \
        const double rise = after - near;                                                                        \
        const double ratio = n_near * n_after / (both > 1.0 ? both : 1.0) * (rise * rise) / twice_variance;      \
        const int32_t step = (rise > 0.0) & (after - column > least_step) & (n_near >= 3.0) & (n_after >= half); \
        out[bin] = step ? ratio : 0.0;                                                                           \
    }
        const int64_t whole = at_most(blank + window > begin ? blank + window : begin, end);
        for (int64_t bin = begin; bin < whole; bin++)
            STEP(blank)
        for (int64_t bin = whole; bin < end; bin++)
            STEP(bin - window)
#undef STEP
    }
}

/* ratios, score (n_pings, n_bins); score: adds each ping's ratios times share, brought to the same highest value, vote,
 * unless that is less than evidence.
 */
WIDE void auv_mcm_waterfall_votes(int64_t n_pings, int64_t n_bins, const double *restrict ratios, double share,
                                  double vote, double evidence, double *restrict score)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict ratio = ratios + ping * n_bins;
        double *restrict sum = score + ping * n_bins;
        double highest[8];
        for (int64_t k = 0; k < 8; k++)
            highest[k] = evidence;
        for (int64_t bin = 0; bin + 8 <= n_bins; bin += 8)
            for (int64_t k = 0; k < 8; k++)
                highest[k] = share * ratio[bin + k] > highest[k] ? share * ratio[bin + k] : highest[k];
        for (int64_t bin = n_bins - n_bins % 8; bin < n_bins; bin++)
            highest[0] = share * ratio[bin] > highest[0] ? share * ratio[bin] : highest[0];
        for (int64_t k = 1; k < 8; k++)
            highest[0] = highest[k] > highest[0] ? highest[k] : highest[0];
        const double factor = vote / highest[0];
        for (int64_t bin = 0; bin < n_bins; bin++)
            sum[bin] += share * ratio[bin] * factor;
    }
}

/* Adds a ping to a row that it overlaps by length; the first one starts the row. */
WIDE static void add_ping(int64_t n_columns, double length, const float *restrict from, const uint8_t *restrict bits,
                          int is_first, double *restrict total, double *restrict weight, uint8_t *restrict flags)
{
    if (is_first)
        for (int64_t column = 0; column < n_columns; column++) {
            total[column] = 0.0 + length * (double)from[column];
            weight[column] = length * (double)(bits[column] & VALID);
            flags[column] = bits[column];
        }
    else
        for (int64_t column = 0; column < n_columns; column++) {
            total[column] += length * (double)from[column];
            weight[column] += length * (double)(bits[column] & VALID);
            flags[column] |= bits[column];
        }
}

WIDE static void finish_row(int64_t n_columns, const double *restrict total, const double *restrict weight,
                            double least, float *restrict out, uint8_t *restrict flags)
{
    for (int64_t column = 0; column < n_columns; column++) {
        const int32_t enough = weight[column] >= least;
        const double mean = total[column] / (enough ? weight[column] : 1.0);
        out[column] = (float)(enough ? mean : 0.0);
        flags[column] = (uint8_t)(enough ? (flags[column] & (SATURATED | LOW_RESOLUTION | TURN)) | VALID
                                         : flags[column] & (LOW_RESOLUTION | TURN));
    }
}

/* intensity, mask (n_pings, n_columns) of pings; source, overlap (n_rows, n_steps): the pings that each row overlaps,
 * and by how much. total, weight (n_columns): overwritten. rows, row_mask (n_rows, n_columns): out.
 */
void auv_mcm_waterfall_rows(int64_t n_rows, int64_t n_columns, int64_t n_steps, const int64_t *restrict source,
                            const double *restrict overlap, const float *restrict intensity,
                            const uint8_t *restrict mask, double least, double *restrict total, double *restrict weight,
                            float *restrict rows, uint8_t *restrict row_mask)
{
    for (int64_t row = 0; row < n_rows; row++) {
        float *restrict out = rows + row * n_columns;
        uint8_t *restrict flags = row_mask + row * n_columns;
        int is_first = 1;
        for (int64_t step = 0; step < n_steps; step++) {
            const double length = overlap[row * n_steps + step];
            if (!(length > 0.0))
                continue;
            const int64_t at = source[row * n_steps + step] * n_columns;
            add_ping(n_columns, length, intensity + at, mask + at, is_first, total, weight, flags);
            is_first = 0;
        }
        if (is_first) {
            memset(total, 0, (size_t)n_columns * sizeof *total);
            memset(weight, 0, (size_t)n_columns * sizeof *weight);
            memset(flags, 0, (size_t)n_columns);
        }
        finish_row(n_columns, total, weight, least, out, flags);
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

/* Whether spacing over its straight-line value is out of bounds. */
static inline int32_t is_bent(double stretch, double turn, double ground_m, double limit)
{
    const double ratio = stretch + turn * ground_m;
    return (ratio > limit) | (ratio * limit < 1.0);
}

/* One ping; coarse: LOW_RESOLUTION or 0 by column. */
WIDE static void join_masks(int64_t n, const uint8_t *restrict valid, const uint8_t *restrict saturated,
                            const uint8_t *restrict coarse, uint8_t always, uint8_t *restrict mask)
{
    for (int64_t column = 0; column < n; column++)
        mask[column] = (uint8_t)((valid[column] ? VALID : 0) | (saturated[column] ? SATURATED : 0) | coarse[column] |
                                 always);
}

/* pitch, yaw, fast (n_pings), ground_m (n_columns) rising, coarse (any, n_columns), coarse_row (n_pings): which of them
 * a ping has; valid, saturated (n_pings, n_columns). mask: out.
 */
void auv_mcm_waterfall_masks(int64_t n_pings, int64_t n_columns, const double *restrict pitch,
                             const double *restrict yaw, const uint8_t *restrict fast, const double *restrict ground_m,
                             const uint8_t *restrict coarse, const int64_t *restrict coarse_row,
                             const uint8_t *restrict valid, const uint8_t *restrict saturated, double limit,
                             uint8_t *restrict mask)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double stretch = 1.0 + pitch[ping], turn = yaw[ping];
        const int64_t at = ping * n_columns;
        join_masks(n_columns, valid + at, saturated + at, coarse + coarse_row[ping] * n_columns, fast[ping] ? TURN : 0,
                   mask + at);
        /* The ratio rises or falls along the row: its ends bound all of it. */
        if (!is_bent(stretch, turn, ground_m[0], limit) && !is_bent(stretch, turn, ground_m[n_columns - 1], limit))
            continue;
        for (int64_t column = 0; column < n_columns; column++)
            mask[at + column] |= is_bent(stretch, turn, ground_m[column], limit) ? TURN : 0;
    }
}

/* angle (any, n_columns); angle_row (n_pings): which of them a ping has; values, usable (n_pings, n_columns). centre
 * (n_bins), or NULL for plain sums. bins (n_columns): overwritten. count, total (n_bins): out.
 */
void auv_mcm_waterfall_angle_sums(int64_t n_pings, int64_t n_columns, int64_t n_bins, const double *restrict angle,
                                  const int64_t *restrict angle_row, const double *restrict values,
                                  const uint8_t *restrict usable, const double *restrict centre, double clip,
                                  int32_t *restrict bins, int64_t *restrict count, double *restrict total)
{
    memset(count, 0, (size_t)n_bins * sizeof *count);
    memset(total, 0, (size_t)n_bins * sizeof *total);
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict row = values + ping * n_columns;
        const uint8_t *restrict sure = usable + ping * n_columns;
        if (ping == 0 || angle_row[ping] != angle_row[ping - 1])
            for (int64_t column = 0; column < n_columns; column++)
                bins[column] = (int32_t)at_most((int64_t)angle[angle_row[ping] * n_columns + column], n_bins - 1);
        for (int64_t column = 0; column < n_columns;) {
            /* Neighbours share a bin as a rule. */
            const int32_t bin = bins[column];
            const double middle = centre ? centre[bin] : 0.0, bound = centre ? clip : INFINITY;
            double sum = total[bin];
            int64_t number = 0;
            for (; column < n_columns && bins[column] == bin; column++) {
                double value = row[column] - middle;
                value = value < -bound ? -bound : value;
                value = value > bound ? bound : value;
                sum = sure[column] ? sum + value : sum;
                number += sure[column] != 0;
            }
            total[bin] = sum;
            count[bin] += number;
        }
    }
}

enum { FEW = 24, MAX_HALVINGS = 24, N_SAMPLE = 16, SAMPLE_LOW = 4, SAMPLE_HIGH = 11 };

WIDE static int64_t count_below(int64_t n, const double *restrict values, double limit)
{
    int64_t below = 0;
    for (int64_t i = 0; i < n; i++)
        below += values[i] < limit;
    return below;
}

/* Eight at a time, since each comparison waits for the one before. */
WIDE static void find_ends(int64_t n, const double *restrict values, double *lowest, double *highest)
{
    double low[8], high[8];
    for (int64_t k = 0; k < 8; k++)
        low[k] = high[k] = values[0];
    for (int64_t i = 0; i + 8 <= n; i += 8)
        for (int64_t k = 0; k < 8; k++) {
            low[k] = values[i + k] < low[k] ? values[i + k] : low[k];
            high[k] = values[i + k] > high[k] ? values[i + k] : high[k];
        }
    for (int64_t i = n - n % 8; i < n; i++) {
        low[0] = values[i] < low[0] ? values[i] : low[0];
        high[0] = values[i] > high[0] ? values[i] : high[0];
    }
    for (int64_t k = 1; k < 8; k++) {
        low[0] = low[k] < low[0] ? low[k] : low[0];
        high[0] = high[k] > high[0] ? high[k] : high[0];
    }
    *lowest = low[0];
    *highest = high[0];
}

static void sort_few(int64_t n, double *values)
{
    for (int64_t i = 1; i < n; i++) {
        const double value = values[i];
        int64_t j = i;
        for (; j > 0 && values[j - 1] > value; j--)
            values[j] = values[j - 1];
        values[j] = value;
    }
}

/* Values in [low, high], or in [low, high) where high is open, among which the median is; below: how many are less,
 * left: how many are in. */
typedef struct {
    double low, high;
    int64_t below, left;
    int high_is_open;
} Bracket;

/* Narrows the bracket by a limit where it stays on one side of the first and second of the middle values. Returns
 * whether it does. */
static int narrow(int64_t n, const double *values, double limit, int64_t first, int64_t second, Bracket *bracket)
{
    const int64_t number = count_below(n, values, limit), upto = bracket->below + bracket->left;
    if (number > second) {
        bracket->high = limit;
        bracket->high_is_open = 1;
        bracket->left = number - bracket->below;
    } else if (number <= first) {
        bracket->low = limit;
        bracket->below = number;
        bracket->left = upto - number;
    } else
        return 0;
    return 1;
}

/* Mean of the (n - 1) / 2 th and the n / 2 th of n values by size: halves what lies between two of a sample, or the
 * ends, until few are left, and sorts those. room (n): overwritten.
 */
static double median(int64_t n, const double *restrict values, double *restrict room)
{
    const int64_t first = (n - 1) / 2, second = n / 2;
    Bracket bracket = {.left = n};
    find_ends(n, values, &bracket.low, &bracket.high);
    if (n > 4 * FEW) {
        double sample[N_SAMPLE];
        for (int64_t k = 0; k < N_SAMPLE; k++)
            sample[k] = values[k * (n / N_SAMPLE)];
        sort_few(N_SAMPLE, sample);
        if (sample[SAMPLE_LOW] > bracket.low)
            narrow(n, values, sample[SAMPLE_LOW], first, second, &bracket);
        if (sample[SAMPLE_HIGH] > bracket.low && sample[SAMPLE_HIGH] < bracket.high)
            narrow(n, values, sample[SAMPLE_HIGH], first, second, &bracket);
    }
    for (int halving = 0; halving < MAX_HALVINGS && bracket.left > FEW; halving++) {
        const double middle = 0.5 * bracket.low + 0.5 * bracket.high;
        if (!(middle > bracket.low && middle < bracket.high))
            break;
        if (!narrow(n, values, middle, first, second, &bracket)) {
            double under = bracket.low, over = bracket.high; /* one on either side */
            for (int64_t i = 0; i < n; i++) {
                under = values[i] < middle && values[i] > under ? values[i] : under;
                over = values[i] >= middle && values[i] < over ? values[i] : over;
            }
            return 0.5 * (under + over);
        }
    }
    int64_t left = 0;
    for (int64_t i = 0; i < n; i++)
        if (values[i] >= bracket.low && (bracket.high_is_open ? values[i] < bracket.high : values[i] <= bracket.high))
            room[left++] = values[i];
    sort_few(left, room);
    return 0.5 * (room[first - bracket.below] + room[second - bracket.below]);
}

/* altitude (n_pings), NaN where unknown. score (n_pings, n_bins): takes `gate` off bins, of bin_m each, at ranges
 * beyond `ratio` of the altitude, either way, and off each `pull` times the logarithm of its range over the altitude.
 */
void auv_mcm_waterfall_pull(int64_t n_pings, int64_t n_bins, const double *restrict altitude, double bin_m,
                            double ratio, double gate, double pull, double *restrict score)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double reading = altitude[ping];
        double *restrict to = score + ping * n_bins;
        if (!(reading > 0.0 && reading < INFINITY))
            continue;
        for (int64_t bin = 0; bin < n_bins; bin++) {
            const double range = (double)bin * bin_m, from = range > bin_m ? range : bin_m;
            const double off = (range > ratio * reading) | (range * ratio < reading) ? gate : 0.0;
            to[bin] = to[bin] - off - fabs(log(from / reading)) * pull;
        }
    }
}

/* values, usable (n_rows, n), usable NULL where all are. room (2 n + 2): overwritten. medians (n_rows): out, NaN where
 * fewer than least are usable.
 */
void auv_mcm_waterfall_medians(int64_t n_rows, int64_t n, const double *restrict values, const uint8_t *restrict usable,
                               int64_t least, double *restrict room, double *restrict medians)
{
    for (int64_t row = 0; row < n_rows; row++) {
        const double *from = values + row * n;
        int64_t number = n;
        if (usable) {
            number = 0;
            for (int64_t i = 0; i < n; i++) {
                room[number] = from[i];
                number += usable[row * n + i] != 0;
            }
            from = room;
        }
        medians[row] = number > 0 && number >= least ? median(number, from, room + n + 1) : NAN;
    }
}

/* values (n_pings, n_columns), factor (any, n_columns), factor_row (n_pings): which of them a ping has. product: out.
 */
WIDE void auv_mcm_waterfall_scale(int64_t n_pings, int64_t n_columns, const double *restrict values,
                                  const double *restrict factor, const int64_t *restrict factor_row,
                                  float *restrict product)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double *restrict from = values + ping * n_columns, *restrict by = factor + factor_row[ping] * n_columns;
        float *restrict to = product + ping * n_columns;
        for (int64_t column = 0; column < n_columns; column++)
            to[column] = (float)(from[column] * by[column]);
    }
}

/* angle (n). known, level (n_known): rising bins, whose values stand at their middles; place (n_bins + 1): of the last
 * known bin whose middle is not beyond that of each bin before, -1 for none. slope (n_known - 1). curve (n): out.
 */
void auv_mcm_waterfall_curve(int64_t n, const double *restrict angle, const double *restrict middle,
                             const double *restrict level, int64_t n_known, const double *restrict slope,
                             const int32_t *restrict place, double *restrict curve)
{
    for (int64_t i = 0; i < n; i++) {
        const int64_t bin = (int64_t)angle[i];
        const int32_t k = place[bin + (angle[i] - (double)bin >= 0.5)];
        if (k < 0)
            curve[i] = level[0];
        else if (k >= n_known - 1)
            curve[i] = level[n_known - 1];
        else
            curve[i] = slope[k] * (angle[i] - middle[k]) + level[k];
    }
}
