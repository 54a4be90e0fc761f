/* What every row of a waterfall goes through one by one, see waterfall_rows.py for its definition. */

#include "waterfall.h"

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
    /* Without branches, which half of the values would surprise. */
    const double low = bracket.low, high = bracket.high_is_open ? bracket.high : nextafter(bracket.high, INFINITY);
    int64_t left = 0;
    for (int64_t i = 0; i < n; i++) {
        room[left] = values[i];
        left += (values[i] >= low) & (values[i] < high);
    }
    sort_few(left, room);
    return 0.5 * (room[first - bracket.below] + room[second - bracket.below]);
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

/* Lowest of the values that are sure, infinity where none is. */
WIDE static double lowest_of(int64_t n, const double *restrict values, const uint8_t *restrict sure)
{
    double low[8];
    for (int64_t k = 0; k < 8; k++)
        low[k] = INFINITY;
    for (int64_t i = 0; i + 8 <= n; i += 8)
        for (int64_t k = 0; k < 8; k++)
            low[k] = sure[i + k] && values[i + k] < low[k] ? values[i + k] : low[k];
    for (int64_t i = n - n % 8; i < n; i++)
        low[0] = sure[i] && values[i] < low[0] ? values[i] : low[0];
    for (int64_t k = 1; k < 8; k++)
        low[0] = low[k] < low[0] ? low[k] : low[0];
    return low[0];
}

WIDE static void raise_row(int64_t n, const uint8_t *restrict sure, double floor, double *restrict values)
{
    for (int64_t i = 0; i < n; i++) {
        const double value = values[i] > floor ? values[i] : floor;
        values[i] = sure[i] ? value : 1.0;
    }
}

/* sure (n_rows, n). room (n + 1): overwritten. values (n_rows, n), not negative: in and out, raised to a share of their
 * row's median and `least` more, 1 where not sure.
 */
void auv_mcm_waterfall_floor(int64_t n_rows, int64_t n, const uint8_t *restrict sure, double share, double least,
                             double *restrict room, double *restrict values)
{
    for (int64_t row = 0; row < n_rows; row++) {
        double *restrict here = values + row * n;
        const double lowest = lowest_of(n, here, sure + row * n), bound = lowest * ((1.0 - 1e-9) / share);
        /* Where most values are below the lowest over the share, so is the median, and the floor below the lowest. */
        const int is_above = lowest > 1e20 * least && 2 * count_below(n, here, bound) > n;
        raise_row(n, sure + row * n, is_above ? 0.0 : share * median(n, here, room) + least, here);
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

/* angle (n). bins (n_known): rising, whose level (n_known) stands at their middles; slope (n_known - 1): in between.
 * place (last bin + 2): overwritten, the last known bin whose middle is not beyond that of each bin before, -1 for
 * none. curve (n): out.
 */
void auv_mcm_waterfall_curve(int64_t n, const double *restrict angle, int64_t n_known, const int64_t *restrict bins,
                             const double *restrict level, const double *restrict slope, int32_t *restrict place,
                             double *restrict curve)
{
    const int64_t top = bins[n_known - 1] + 1;
    int32_t known = -1;
    for (int64_t bin = 0; bin <= top; bin++) {
        place[bin] = known;
        known += known + 1 < n_known && bins[known + 1] == bin;
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t bin = (int64_t)angle[i];
        const int32_t k = place[at_most(bin + (angle[i] - (double)bin >= 0.5), top)];
        if (k < 0)
            curve[i] = level[0];
        else if (k >= n_known - 1)
            curve[i] = level[n_known - 1];
        else
            curve[i] = slope[k] * (angle[i] - ((double)bins[k] + 0.5)) + level[k];
    }
}
