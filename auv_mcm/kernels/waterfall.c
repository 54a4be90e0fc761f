/* What every ping and every row of a waterfall goes through, see waterfall.py for its definition.
 *
 * Nothing but sums, products and quotients in numpy's order, so that numpy gives the same bits; logarithms, exponentials and angles, which
 * no two libraries round alike, are left to numpy.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { ROWS_TOGETHER = 4 };
enum { VALID = 1, SATURATED = 2, LOW_RESOLUTION = 4, TURN = 8 }; /* of records.py */

static inline int64_t at_most(int64_t value, int64_t last) { return value < last ? value : last; }

/* values (n_rows, n_columns). sums (n_rows, n_columns + 1): out, less the sum from each column to the last. Rows go together since each
 * sum waits for the one before.
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

/* Sums up to edges given in samples, whole part and fraction apart, and from each edge to the next. at (n_edges + 1): overwritten. */
WIDE static void between(int64_t n_edges, const double *restrict sums, const int32_t *restrict whole, const double *restrict fraction,
                         double *restrict at, double *restrict difference)
{
    for (int64_t edge = 0; edge < n_edges; edge++) {
        const double low = sums[whole[edge]], high = sums[whole[edge] + 1];
        at[edge] = low + fraction[edge] * (high - low);
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++)
        difference[edge] = at[edge + 1] - at[edge];
}

WIDE static void place_edges(int64_t n_edges, int64_t n_samples, const double *restrict edges, double first, double per_spacing,
                             int32_t *restrict whole, double *restrict fraction, double *restrict width, double *restrict sampled)
{
    const double last = (double)n_samples;
    for (int64_t edge = 0; edge < n_edges; edge++)
        width[edge] = (edges[edge] - first) * per_spacing + 0.5;
    for (int64_t edge = 0; edge < n_edges; edge++) {
        double position = width[edge];
        position = position < 0.0 ? 0.0 : position;
        position = position > last ? last : position;
        const int32_t sample = (int32_t)position, kept = sample < (int32_t)n_samples - 1 ? sample : (int32_t)n_samples - 1;
        whole[edge] = kept;
        fraction[edge] = position - (double)kept;
        sampled[edge] = fraction[edge] + (double)kept;
    }
    for (int64_t edge = 0; edge + 1 < n_edges; edge++) {
        width[edge] = width[edge + 1] - width[edge];
        sampled[edge] = sampled[edge + 1] - sampled[edge];
    }
}

/* sums (n_pings, n_samples + 1), weights and clipped the same or NULL. edges (n_pings, n_edges), or (1, n_edges) where edge_step is 0.
 * whole (n_edges), scratch (6, n_edges): overwritten. intensity, valid, saturated (n_pings, n_edges - 1): out.
 */
WIDE void auv_mcm_waterfall_means(int64_t n_pings, int64_t n_samples, int64_t n_edges, const double *restrict sums,
                                  const double *restrict weights, const double *restrict clipped, double first, double per_spacing,
                                  const double *restrict edges, int64_t edge_step, int32_t *restrict whole, double *restrict scratch,
                                  double *restrict intensity, uint8_t *restrict valid, uint8_t *restrict saturated)
{
    const int64_t n = n_edges - 1;
    double *restrict fraction = scratch, *restrict width = scratch + n_edges, *restrict sampled = scratch + 2 * n_edges;
    double *restrict at = scratch + 3 * n_edges, *restrict weighed = scratch + 4 * n_edges, *restrict clip = scratch + 5 * n_edges;
    for (int64_t ping = 0; ping < n_pings; ping++) {
        double *restrict mean = intensity + ping * n;
        uint8_t *restrict sure = valid + ping * n, *restrict full = saturated + ping * n;
        if (ping == 0 || edge_step)
            place_edges(n_edges, n_samples, edges + ping * edge_step, first, per_spacing, whole, fraction, width, sampled);
        if (weights)
            between(n_edges, weights + ping * (n_samples + 1), whole, fraction, at, weighed);
        between(n_edges, sums + ping * (n_samples + 1), whole, fraction, at, mean);
        const double *restrict weight = weights ? weighed : sampled;
        for (int64_t column = 0; column < n; column++) {
            const int32_t enough = (weight[column] >= 0.5 * width[column]) & (weight[column] > 1e-9);
            const double value = mean[column] / (enough ? weight[column] : 1.0);
            mean[column] = enough ? value : 0.0;
            sure[column] = (uint8_t)enough;
        }
        if (clipped) {
            between(n_edges, clipped + ping * (n_samples + 1), whole, fraction, at, clip);
            for (int64_t column = 0; column < n; column++)
                full[column] = (uint8_t)((clip[column] > 0.25 * weight[column]) & sure[column]);
        } else
            memset(full, 0, (size_t)n);
    }
}

/* values, valid (n_pings, n_bins). total, count (n_bins + 1): overwritten. score (n_pings, n_bins): out, where a step may be, else as is. */
WIDE void auv_mcm_waterfall_steps(int64_t n_pings, int64_t n_bins, const double *restrict values, const uint8_t *restrict valid,
                                  int64_t blank, int64_t window, double least_step, double twice_variance, double *restrict total,
                                  double *restrict count, double *restrict score)
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
#define STEP(START)                                                                                                                      \
    {                                                                                                                                    \
        const double n_after = count[bin + window] - count[bin], n_near = count[bin] - count[START];                                     \
        const double n_column = count[bin] - count[blank], both = n_near + n_after;                                                      \
        const double after = (total[bin + window] - total[bin]) / (n_after > 1.0 ? n_after : 1.0);                                       \
        const double near = (total[bin] - total[START]) / (n_near > 1.0 ? n_near : 1.0);                                                 \
        const double column = (total[bin] - total[blank]) / (n_column > 1.0 ? n_column : 1.0);                                           \
        const double rise = after - near;                                                                                                \
        const double ratio = n_near * n_after / (both > 1.0 ? both : 1.0) * (rise * rise) / twice_variance;                              \
        const int32_t step = (rise > 0.0) & (after - column > least_step) & (n_near >= 3.0) & (n_after >= half);                         \
        out[bin] = step ? ratio : 0.0;                                                                                                   \
    }
        const int64_t whole = at_most(blank + window > begin ? blank + window : begin, end);
        for (int64_t bin = begin; bin < whole; bin++)
            STEP(blank)
        for (int64_t bin = whole; bin < end; bin++)
            STEP(bin - window)
#undef STEP
    }
}

/* intensity, mask (n_pings, n_columns) of pings; source, overlap (n_rows, n_steps): the pings that each row overlaps, and by how much.
 * total, weight (n_columns): overwritten. rows, row_mask (n_rows, n_columns): out.
 */
WIDE void auv_mcm_waterfall_rows(int64_t n_rows, int64_t n_columns, int64_t n_steps, const int64_t *restrict source,
                                 const double *restrict overlap, const float *restrict intensity, const uint8_t *restrict mask,
                                 double least, double *restrict total, double *restrict weight, float *restrict rows,
                                 uint8_t *restrict row_mask)
{
    for (int64_t row = 0; row < n_rows; row++) {
        float *restrict out = rows + row * n_columns;
        uint8_t *restrict flags = row_mask + row * n_columns;
        memset(total, 0, (size_t)n_columns * sizeof *total);
        memset(weight, 0, (size_t)n_columns * sizeof *weight);
        memset(flags, 0, (size_t)n_columns);
        for (int64_t step = 0; step < n_steps; step++) {
            const double length = overlap[row * n_steps + step];
            if (!(length > 0.0))
                continue;
            const float *restrict from = intensity + source[row * n_steps + step] * n_columns;
            const uint8_t *restrict bits = mask + source[row * n_steps + step] * n_columns;
            for (int64_t column = 0; column < n_columns; column++) {
                total[column] += length * (double)from[column];
                weight[column] += length * (double)(bits[column] & VALID);
                flags[column] |= bits[column];
            }
        }
        for (int64_t column = 0; column < n_columns; column++) {
            const int32_t enough = weight[column] >= least;
            const double mean = total[column] / (enough ? weight[column] : 1.0);
            out[column] = (float)(enough ? mean : 0.0);
            flags[column] = (uint8_t)(enough ? (flags[column] & (SATURATED | LOW_RESOLUTION | TURN)) | VALID
                                             : flags[column] & (LOW_RESOLUTION | TURN));
        }
    }
}

/* What a box of rows holds: sums above its first row and below its last one, from the image's corner on, and valid pixels by column. */
typedef struct {
    double *lower, *upper, *band;
    int32_t *valid, *n_band;
} Box;

/* Takes the row that enters the box and the one that leaves it, NULL for none. Their sums wait for the one before and go together. */
static void move_down(int64_t n, const float *enters, const float *leaves, const uint8_t *more, const uint8_t *less, Box box)
{
    double in = 0.0, out = 0.0;
    if (enters && leaves)
        for (int64_t column = 0; column < n; column++) {
            box.lower[column + 1] += in += enters[column];
            box.upper[column + 1] += out += leaves[column];
        }
    else if (enters)
        for (int64_t column = 0; column < n; column++)
            box.lower[column + 1] += in += enters[column];
    else if (leaves)
        for (int64_t column = 0; column < n; column++)
            box.upper[column + 1] += out += leaves[column];
    for (int64_t column = 0; more && column < n; column++)
        box.valid[column] += more[column];
    for (int64_t column = 0; less && column < n; column++)
        box.valid[column] -= less[column];
}

/* Running sums along the box's rows, with what stands at their ends repeated `pad` times on either side. */
static void spread(int64_t n, int64_t pad, Box box)
{
    int32_t count = 0;
    for (int64_t column = 0; column <= n; column++)
        box.band[pad + column] = box.lower[column] - box.upper[column];
    for (int64_t column = 0; column < n; column++) {
        box.n_band[pad + column] = count;
        count += box.valid[column];
    }
    box.n_band[pad + n] = count;
    for (int64_t column = 0; column < pad; column++) {
        box.band[column] = box.band[pad];
        box.n_band[column] = box.n_band[pad];
        box.band[pad + n + 1 + column] = box.band[pad + n];
        box.n_band[pad + n + 1 + column] = box.n_band[pad + n];
    }
}

/* room (2 (n_columns + 1) + n_columns + 1 + 2 pad), n_room (n_columns + n_columns + 1 + 2 pad): overwritten. */
static Box empty_box(int64_t n_columns, double *room, int32_t *n_room)
{
    const Box box = {room, room + n_columns + 1, room + 2 * (n_columns + 1), n_room, n_room + n_columns};
    memset(room, 0, (size_t)(2 * (n_columns + 1)) * sizeof *room);
    memset(n_room, 0, (size_t)n_columns * sizeof *n_room);
    return box;
}

static void enter_row(int64_t row, int64_t n_rows, int64_t n_columns, int64_t half_rows, const float *values, const uint8_t *usable, Box box)
{
    const int64_t enters = row + half_rows, leaves = row - half_rows - 1;
    const int64_t in = enters * n_columns, out = leaves * n_columns;
    move_down(n_columns, enters < n_rows ? values + in : NULL, leaves >= 0 ? values + out : NULL, enters < n_rows ? usable + in : NULL,
              leaves >= 0 ? usable + out : NULL, box);
}

WIDE static void box_means(int64_t n, int64_t half, const double *restrict band, const int32_t *restrict n_band, double *restrict mean,
                           int32_t *restrict count)
{
    for (int64_t column = 0; column < n; column++) {
        const int32_t number = n_band[column + half + 1] - n_band[column - half];
        mean[column] = (band[column + half + 1] - band[column - half]) * (1.0 / (double)(number > 1 ? number : 1));
        count[column] = number;
    }
}

/* logarithms, usable (n_rows, n_columns). mean, count (n_columns), room, n_room: overwritten. places, limits: out, n_places (1): how many. */
void auv_mcm_waterfall_glints(int64_t n_rows, int64_t n_columns, int64_t half_rows, int64_t half_columns, const float *restrict logarithms,
                              const uint8_t *restrict usable, double above, double highest, double slack, double *restrict mean,
                              int32_t *restrict count, double *room, int32_t *n_room, int32_t *restrict places, double *restrict limits,
                              int64_t *restrict n_places)
{
    const int64_t pad = half_columns + 1;
    const Box box = empty_box(n_columns, room, n_room);
    int64_t n = 0;
    for (int64_t row = -half_rows; row < n_rows; row++) {
        enter_row(row, n_rows, n_columns, half_rows, logarithms, usable, box);
        if (row < 0)
            continue;
        spread(n_columns, pad, box);
        box_means(n_columns, half_columns, box.band + pad, box.n_band + pad, mean, count);
        for (int64_t column = 0; column < n_columns; column++) {
            const double limit = mean[column] + above;
            places[n] = (int32_t)(row * n_columns + column);
            limits[n] = limit;
            n += (usable[row * n_columns + column] != 0) &
                 ((double)logarithms[row * n_columns + column] + slack >= (limit < highest ? limit : highest));
        }
    }
    *n_places = n;
}

/* level, usable (n_rows, n_columns). count (n_columns), room, n_room: overwritten. mean, known (n_rows, n_columns): out. */
void auv_mcm_waterfall_level(int64_t n_rows, int64_t n_columns, int64_t half_rows, int64_t half_columns, const float *restrict level,
                             const uint8_t *restrict usable, double least_share, int32_t *restrict count, double *room, int32_t *n_room,
                             double *restrict mean, uint8_t *restrict known)
{
    const int64_t pad = half_columns + 1;
    const Box box = empty_box(n_columns, room, n_room);
    for (int64_t row = -half_rows; row < n_rows; row++) {
        enter_row(row, n_rows, n_columns, half_rows, level, usable, box);
        if (row < 0)
            continue;
        spread(n_columns, pad, box);
        box_means(n_columns, half_columns, box.band + pad, box.n_band + pad, mean + row * n_columns, count);
        const int64_t rows = at_most(row + half_rows, n_rows - 1) - (row > half_rows ? row - half_rows : 0) + 1;
        for (int64_t column = 0; column < n_columns; column++) {
            const int64_t near = column > half_columns ? column - half_columns : 0;
            const int64_t columns = at_most(column + half_columns, n_columns - 1) - near + 1;
            const double wanted = least_share * (double)(rows * columns);
            known[row * n_columns + column] = (uint8_t)(((double)count[column] >= (wanted > 1.0 ? wanted : 1.0)) &
                                                        (mean[row * n_columns + column] > 0.0));
        }
    }
}

/* intensity, mean, known, mask: n each. normalised, masked: out. */
WIDE void auv_mcm_waterfall_normalise(int64_t n, const float *restrict intensity, const double *restrict mean,
                                      const uint8_t *restrict known, const uint8_t *restrict mask, float *restrict normalised,
                                      uint8_t *restrict masked)
{
    for (int64_t i = 0; i < n; i++) {
        const int32_t sure = known[i] != 0, echo = sure & ((mask[i] & VALID) != 0);
        const double ratio = (double)intensity[i] / (echo ? mean[i] : 1.0);
        normalised[i] = (float)(echo ? ratio : 0.0);
        masked[i] = (uint8_t)(sure ? mask[i] : mask[i] & ~VALID);
    }
}

/* level_m, pitch, yaw, fast (n_pings), ground_m (n_columns), valid, saturated (n_pings, n_columns). tangent, mask: out. */
WIDE void auv_mcm_waterfall_masks(int64_t n_pings, int64_t n_columns, const double *restrict level_m, const double *restrict pitch,
                                  const double *restrict yaw, const uint8_t *restrict fast, const double *restrict ground_m,
                                  const uint8_t *restrict valid, const uint8_t *restrict saturated, double steepest, double flattest,
                                  double limit, double *restrict tangent, uint8_t *restrict mask)
{
    for (int64_t ping = 0; ping < n_pings; ping++) {
        const double height_m = level_m[ping], stretch = 1.0 + pitch[ping], turn = yaw[ping];
        const int32_t always = fast[ping] != 0;
        for (int64_t column = 0; column < n_columns; column++) {
            const int64_t i = ping * n_columns + column;
            const double slope = height_m / ground_m[column], ratio = stretch + turn * ground_m[column];
            const int32_t coarse = (slope > steepest) | (slope < flattest);
            const int32_t bent = (ratio > limit) | (ratio * limit < 1.0) | always;
            tangent[i] = slope;
            mask[i] = (uint8_t)((valid[i] ? VALID : 0) | (saturated[i] ? SATURATED : 0) | (coarse ? LOW_RESOLUTION : 0) | (bent ? TURN : 0));
        }
    }
}

/* angle, values, usable: n each. centre (n_bins), or NULL for plain sums. count, total (n_bins): out. */
void auv_mcm_waterfall_angle_sums(int64_t n, int64_t n_bins, const double *restrict angle, const double *restrict values,
                                  const uint8_t *restrict usable, const double *restrict centre, double clip, int64_t *restrict count,
                                  double *restrict total)
{
    memset(count, 0, (size_t)n_bins * sizeof *count);
    memset(total, 0, (size_t)n_bins * sizeof *total);
    for (int64_t i = 0; i < n; i++) {
        if (!usable[i])
            continue;
        const int64_t bin = at_most((int64_t)angle[i], n_bins - 1);
        double value = values[i];
        if (centre) {
            value -= centre[bin];
            value = value < -clip ? -clip : value;
            value = value > clip ? clip : value;
        }
        count[bin]++;
        total[bin] += value;
    }
}

/* angle (n). known, level (n_known): rising bins, whose values stand at their middles; place (n_bins + 1): of the last known bin whose
 * middle is not beyond that of each bin before, -1 for none. slope (n_known - 1). curve (n): out.
 */
void auv_mcm_waterfall_curve(int64_t n, const double *restrict angle, const double *restrict middle, const double *restrict level,
                             int64_t n_known, const double *restrict slope, const int32_t *restrict place, double *restrict curve)
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
