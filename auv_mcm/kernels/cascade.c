/* Codes, integral images and boosted stumps of the trained cascade, see cascade.py for their definition.
 *
 * Stumps run breadth-first: all windows of a block through one stump before the next, so that the iterations are
 * independent. While many windows of a block are alive, whole rows are weighed, which vectorises; then runs of
 * neighbours, and where hardly any window has a neighbour, one by one. An outcome is looked up or blended, never
 * branched upon: on speckle it is a coin's. Contrasts are mostly against one and the same box, the whole window's,
 * whose sum is taken once for all stumps of a group.
 */

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { LOWER_RIGHT, UPPER_RIGHT, LOWER_LEFT, UPPER_LEFT, CORNERS };
enum { LANES = 8, SEGMENT = 1024, BLOCK = 8192, LIST = 512, DENSE_SHARE = 2, DIGIT_BITS = 11 };
enum { RUN_COST = 3, RUN_WINDOWS = 2 }; /* a run costs about as much as 3 / 2 windows by themselves */

/* Left to itself, gcc makes vectors of values gathered one by one, which takes half as long again as one window at a
 * time. */
#if defined(__GNUC__) && !defined(__clang__)
#define ONE_BY_ONE __attribute__((optimize("no-tree-vectorize")))
#else
#define ONE_BY_ONE
#endif

/* One band's form of a stump, the record STUMP of cascade.py. */
typedef struct {
    int32_t offset[3][CORNERS];
    float weight[3];
    int32_t leaf[2];
    int32_t contrast;
} Stump;

typedef struct {
    int32_t stop, reject;
} Group;

/* Neighbouring windows of one row: index of the first in the integral images, number, and number with those up to a
 * multiple of LANES. */
typedef struct {
    int64_t at, n, padded;
} Segment;

WIDE void auv_mcm_cascade_encode(int64_t n, const float *restrict intensity, const uint8_t *restrict mask,
                                 uint16_t *restrict codes, uint8_t *restrict valid)
{
    for (int64_t i = 0; i < n; i++) {
        const float value = intensity[i];
        const int32_t measured = mask[i] & 1, echo = value == value ? measured : 0;
        float bounded = value > 0.0f ? value : 0.0f;
        bounded = bounded < 16.0f ? bounded : 16.0f;
        /* In numbers of 2^23 and more nothing is left of fractions: nearest, halves to even. */
        const float shifted = bounded * 1024.0f + 12582912.0f;
        const int32_t code = (int32_t)(shifted - 12582912.0f);
        codes[i] = (uint16_t)(echo ? code : 1024);
        valid[i] = (uint8_t)echo;
    }
}

/* Four sums at a time depend on the last one only once. */
#define INTEGRAL(NAME, TYPE)                                                                                   \
    void NAME(int64_t n_rows, int64_t n_columns, int64_t margin_rows, int64_t margin_near, int64_t margin_far, \
              uint32_t beyond, const TYPE *restrict values, uint32_t *restrict sums)                           \
    {                                                                                                          \
        const int64_t stride = margin_near + n_columns + margin_far + 1;                                       \
        memset(sums, 0, (size_t)stride * sizeof *sums);                                                        \
        for (int64_t row = -margin_rows; row < n_rows + margin_rows; row++) {                                  \
            const uint32_t *restrict above = sums + (row + margin_rows) * stride;                              \
            uint32_t *restrict here = sums + (row + margin_rows + 1) * stride;                                 \
            const TYPE *restrict from = values + row * n_columns;                                              \
            const int64_t columns = row < 0 || row >= n_rows ? 0 : n_columns, first = margin_near + 1;         \
            uint32_t total = beyond * (uint32_t)margin_near;                                                   \
            int64_t column = 0;                                                                                \
            for (int64_t before = 0; before < first; before++)                                                 \
                here[before] = above[before] + beyond * (uint32_t)before;                                      \
            for (; column + 4 <= columns; column += 4) {                                                       \
                const uint32_t one = from[column], two = one + from[column + 1];                               \
                const uint32_t three = two + from[column + 2], four = three + from[column + 3];                \
                here[first + column] = above[first + column] + (total + one);                                  \
                here[first + column + 1] = above[first + column + 1] + (total + two);                          \
                here[first + column + 2] = above[first + column + 2] + (total + three);                        \
                here[first + column + 3] = above[first + column + 3] + (total + four);                         \
                total += four;                                                                                 \
            }                                                                                                  \
            for (; column < columns; column++) {                                                               \
                total += from[column];                                                                         \
                here[first + column] = above[first + column] + total;                                          \
            }                                                                                                  \
            for (column += first; column < stride; column++) {                                                 \
                total += beyond;                                                                               \
                here[column] = above[column] + total;                                                          \
            }                                                                                                  \
        }                                                                                                      \
    }

INTEGRAL(auv_mcm_cascade_sums, uint16_t)
INTEGRAL(auv_mcm_cascade_counts, uint8_t)

static inline int32_t box(const uint32_t *at, const int32_t *offset)
{
    return (int32_t)((at[offset[LOWER_RIGHT]] - at[offset[UPPER_RIGHT]]) -
                     (at[offset[LOWER_LEFT]] - at[offset[UPPER_LEFT]]));
}

/* The first contrast among stumps [from, stop), whose third box others of the group share; NULL if there is none. */
static const Stump *find_whole(const Stump *stumps, int32_t from, int32_t stop)
{
    while (from < stop && !stumps[from].contrast)
        from++;
    return from < stop ? stumps + from : NULL;
}

/* sum if the stump is a contrast against the box of `whole`, else NULL. */
static inline const float *shared_sum(const Stump *stump, const Stump *whole, const float *sum)
{
    return whole && stump->contrast && !memcmp(stump->offset[2], whole->offset[2], sizeof whole->offset[2]) ? sum
                                                                                                            : NULL;
}

/* whole: out, sums over the third box of a contrast; (n), of runs (n, LANES). */
ONE_BY_ONE static void sum_list(const uint32_t *restrict sums, const Stump *restrict stump, int64_t n,
                                const int32_t *restrict at, float *restrict whole)
{
    for (int64_t i = 0; i < n; i++)
        whole[i] = (float)box(sums + at[i], stump->offset[2]);
}

WIDE static void sum_runs(const uint32_t *restrict sums, const Stump *restrict stump, int64_t n,
                          const int32_t *restrict at, float *restrict whole)
{
    const Stump s = *stump;
    for (int64_t run = 0; run < n; run++) {
        const uint32_t *here = sums + at[run];
        float *restrict lane = whole + run * LANES;
        for (int i = 0; i < LANES; i++)
            lane[i] = (float)box(here + i, s.offset[2]);
    }
}

/* n: a multiple of LANES. */
WIDE static void sum_row(const uint32_t *restrict here, const Stump *restrict stump, int64_t n, float *restrict whole)
{
    const uint32_t *const w0 = here + stump->offset[2][0], *const w1 = here + stump->offset[2][1];
    const uint32_t *const w2 = here + stump->offset[2][2], *const w3 = here + stump->offset[2][3];
    n -= n % LANES;
    for (int64_t i = 0; i < n; i++)
        whole[i] = (float)(int32_t)((w0[i] - w1[i]) - (w2[i] - w3[i]));
}

/* whole: those sums, NULL for a contrast with a box of its own; the same below. */
ONE_BY_ONE static void weigh_list(const uint32_t *restrict sums, const Stump *restrict stump, int64_t n,
                                  const int32_t *restrict at, const float *restrict whole, int32_t *restrict score)
{
    const Stump s = *stump;
    if (s.contrast && whole)
        for (int64_t i = 0; i < n; i++) {
            const uint32_t *here = sums + at[i];
            const float a = (float)box(here, s.offset[0]) * s.weight[0],
                        b = (float)box(here, s.offset[1]) * s.weight[1];
            score[i] += s.leaf[a - b < whole[i] * s.weight[2]];
        }
    else if (s.contrast)
        for (int64_t i = 0; i < n; i++) {
            const uint32_t *here = sums + at[i];
            const float a = (float)box(here, s.offset[0]) * s.weight[0],
                        b = (float)box(here, s.offset[1]) * s.weight[1];
            score[i] += s.leaf[a - b < (float)box(here, s.offset[2]) * s.weight[2]];
        }
    else
        for (int64_t i = 0; i < n; i++) {
            const uint32_t *here = sums + at[i];
            score[i] +=
                s.leaf[(float)box(here, s.offset[0]) * s.weight[0] < (float)box(here, s.offset[1]) * s.weight[1]];
        }
}

/* Windows of a list that lie within LANES of each other in a row go together. at: of the first one each; slot: of each
 * window among all lanes. Returns the number of such runs. */
static int64_t find_runs(int64_t n, const int32_t *restrict place, int32_t *restrict at, int32_t *restrict slot)
{
    int64_t runs = 0;
    for (int64_t i = 0; i < n; i++) {
        const int32_t begins = runs == 0 || place[i] - at[runs - 1] >= LANES;
        runs += begins;
        if (begins)
            at[runs - 1] = place[i];
        slot[i] = (int32_t)(runs - 1) * LANES + place[i] - at[runs - 1];
    }
    return runs;
}

WIDE static void weigh_runs(const uint32_t *restrict sums, const Stump *restrict stump, int64_t n,
                            const int32_t *restrict at, const float *restrict whole, int32_t *restrict score)
{
    const Stump s = *stump;
    const int32_t above = s.leaf[0], below = s.leaf[1];
    if (s.contrast && whole)
        for (int64_t run = 0; run < n; run++) {
            const uint32_t *here = sums + at[run];
            const float *restrict w = whole + run * LANES;
            int32_t *restrict lane = score + run * LANES;
            for (int i = 0; i < LANES; i++) {
                const float a = (float)box(here + i, s.offset[0]) * s.weight[0],
                            b = (float)box(here + i, s.offset[1]) * s.weight[1];
                lane[i] += a - b < w[i] * s.weight[2] ? below : above;
            }
        }
    else if (s.contrast)
        for (int64_t run = 0; run < n; run++) {
            const uint32_t *here = sums + at[run];
            int32_t *restrict lane = score + run * LANES;
            for (int i = 0; i < LANES; i++) {
                const float a = (float)box(here + i, s.offset[0]) * s.weight[0],
                            b = (float)box(here + i, s.offset[1]) * s.weight[1];
                lane[i] += a - b < (float)box(here + i, s.offset[2]) * s.weight[2] ? below : above;
            }
        }
    else
        for (int64_t run = 0; run < n; run++) {
            const uint32_t *here = sums + at[run];
            int32_t *restrict lane = score + run * LANES;
            for (int i = 0; i < LANES; i++) {
                const float a = (float)box(here + i, s.offset[0]) * s.weight[0],
                            b = (float)box(here + i, s.offset[1]) * s.weight[1];
                lane[i] += a < b ? below : above;
            }
        }
}

/* n: a multiple of LANES. */
WIDE static void weigh_row(const uint32_t *restrict here, const Stump *restrict stump, int64_t n,
                           const float *restrict whole, int32_t *restrict score)
{
    const int32_t above = stump->leaf[0], below = stump->leaf[1];
    const float weight_a = stump->weight[0], weight_b = stump->weight[1], weight_w = stump->weight[2];
    const uint32_t *const a0 = here + stump->offset[0][0], *const a1 = here + stump->offset[0][1];
    const uint32_t *const a2 = here + stump->offset[0][2], *const a3 = here + stump->offset[0][3];
    const uint32_t *const b0 = here + stump->offset[1][0], *const b1 = here + stump->offset[1][1];
    const uint32_t *const b2 = here + stump->offset[1][2], *const b3 = here + stump->offset[1][3];
    n -= n % LANES;
    if (stump->contrast && whole) {
        for (int64_t i = 0; i < n; i++) {
            const float a = (float)(int32_t)((a0[i] - a1[i]) - (a2[i] - a3[i])) * weight_a;
            const float b = (float)(int32_t)((b0[i] - b1[i]) - (b2[i] - b3[i])) * weight_b;
            score[i] += a - b < whole[i] * weight_w ? below : above;
        }
    } else if (stump->contrast) {
        const uint32_t *const w0 = here + stump->offset[2][0], *const w1 = here + stump->offset[2][1];
        const uint32_t *const w2 = here + stump->offset[2][2], *const w3 = here + stump->offset[2][3];
        for (int64_t i = 0; i < n; i++) {
            const float a = (float)(int32_t)((a0[i] - a1[i]) - (a2[i] - a3[i])) * weight_a;
            const float b = (float)(int32_t)((b0[i] - b1[i]) - (b2[i] - b3[i])) * weight_b;
            const float w = (float)(int32_t)((w0[i] - w1[i]) - (w2[i] - w3[i])) * weight_w;
            score[i] += a - b < w ? below : above;
        }
    } else {
        for (int64_t i = 0; i < n; i++) {
            const float a = (float)(int32_t)((a0[i] - a1[i]) - (a2[i] - a3[i])) * weight_a;
            const float b = (float)(int32_t)((b0[i] - b1[i]) - (b2[i] - b3[i])) * weight_b;
            score[i] += a < b ? below : above;
        }
    }
}

/* Runs groups [first, last) on a list of windows of one band and keeps the survivors at its front. Returns their
 * number. */
static int64_t run_list(const uint32_t *restrict sums, const Stump *restrict stumps, const Group *restrict groups,
                        int64_t first, int64_t last, int64_t restart, int64_t n, int32_t *restrict at,
                        int32_t *restrict score, int64_t *restrict n_alive)
{
    int32_t run_at[LIST], slot[LIST], lanes[LIST * LANES];
    float sum[LIST * LANES];
    for (int64_t group = first; group < last; group++) {
        const int32_t from = group ? groups[group - 1].stop : 0, stop = groups[group].stop,
                      reject = groups[group].reject;
        const Stump *const whole = find_whole(stumps, from, stop);
        int64_t kept = 0;
        for (int64_t start = 0; start < n; start += LIST) {
            const int64_t length = n - start < LIST ? n - start : LIST;
            const int64_t runs = find_runs(length, at + start, run_at, slot);
            if (restart)
                memset(score + start, 0, (size_t)length * sizeof *score);
            if (length * RUN_WINDOWS < runs * RUN_COST) {
                if (whole)
                    sum_list(sums, whole, length, at + start, sum);
                for (int32_t stump = from; stump < stop; stump++)
                    weigh_list(sums, stumps + stump, length, at + start, shared_sum(stumps + stump, whole, sum),
                               score + start);
            } else {
                memset(lanes, 0, (size_t)(runs * LANES) * sizeof *lanes);
                if (whole)
                    sum_runs(sums, whole, runs, run_at, sum);
                for (int32_t stump = from; stump < stop; stump++)
                    weigh_runs(sums, stumps + stump, runs, run_at, shared_sum(stumps + stump, whole, sum), lanes);
                for (int64_t i = 0; i < length; i++)
                    score[start + i] += lanes[slot[i]];
            }
            for (int64_t i = start; i < start + length; i++) {
                const int32_t place = at[i], sum = score[i];
                at[kept] = place;
                score[kept] = sum;
                kept += sum >= reject;
            }
        }
        n = kept;
        n_alive[group] += n;
    }
    return n;
}

/* alive: -1 or 0. Returns how many are left. n: a multiple of LANES. */
WIDE static int64_t keep_alive(int64_t n, const int32_t *restrict score, int32_t reject, int32_t *restrict alive)
{
    int32_t left = 0;
    n -= n % LANES;
    for (int64_t i = 0; i < n; i++) {
        alive[i] &= -(score[i] >= reject);
        left -= alive[i];
    }
    return left;
}

/* Which of n neighbouring windows hold at least `enough` valid pixels and may be centred there: -1 or 0. Returns how
 * many. */
WIDE static int64_t find_windows(int64_t n, const uint32_t *restrict counts, const int32_t *restrict window,
                                 int32_t enough, const uint8_t *restrict usable, int32_t *restrict alive)
{
    const uint32_t *const c0 = counts + window[0], *const c1 = counts + window[1];
    const uint32_t *const c2 = counts + window[2], *const c3 = counts + window[3];
    const int64_t padded = (n + LANES - 1) / LANES * LANES;
    int32_t found = 0;
    for (int64_t i = 0; i < padded; i++)
        alive[i] = -((int32_t)((c0[i] - c1[i]) - (c2[i] - c3[i])) >= enough);
    for (int64_t i = n; i < padded; i++)
        alive[i] = 0;
    if (memchr(usable, 0, (size_t)n))
        for (int64_t i = 0; i < n; i++)
            alive[i] &= -(usable[i] != 0);
    for (int64_t i = 0; i < padded; i++)
        found -= alive[i];
    return found;
}

/* Runs groups [0, n_groups) on the windows of a block and appends the survivors to a list. Returns their number. */
static int64_t open_block(const uint32_t *restrict sums, const Stump *restrict stumps, const Group *restrict groups,
                          int64_t n_groups, int64_t restart, int64_t n_segments, const Segment *restrict segments,
                          int32_t *restrict block_score, int32_t *restrict alive, int32_t *restrict at,
                          int32_t *restrict score, int64_t *restrict n_alive)
{
    int64_t group = 0, total, filled = 0, n = 0;
    float sum[SEGMENT];
    for (int64_t k = 0; k < n_segments; k++)
        filled += segments[k].padded;
    do {
        const int32_t from = group ? groups[group - 1].stop : 0, stop = groups[group].stop;
        if (restart || group == 0)
            memset(block_score, 0, (size_t)filled * sizeof *block_score);
        const Stump *const whole = find_whole(stumps, from, stop);
        for (int64_t k = 0, begin = 0; k < n_segments; begin += segments[k].padded, k++) {
            const uint32_t *const here = sums + segments[k].at;
            if (whole)
                sum_row(here, whole, segments[k].padded, sum);
            for (int32_t stump = from; stump < stop; stump++)
                weigh_row(here, stumps + stump, segments[k].padded, shared_sum(stumps + stump, whole, sum),
                          block_score + begin);
        }
        total = keep_alive(filled, block_score, groups[group].reject, alive);
        n_alive[group] += total;
        group++;
    } while (group < n_groups && total * DENSE_SHARE >= filled);
    for (int64_t k = 0, begin = 0; k < n_segments; begin += segments[k].padded, k++)
        for (int64_t i = 0; i < segments[k].n; i++) {
            at[n] = (int32_t)(segments[k].at + i);
            score[n] = block_score[begin + i];
            n -= alive[begin + i];
        }
    return run_list(sums, stumps, groups, group, n_groups, restart, n, at, score, n_alive);
}

/* edges (n_rows, n_bands + 1), usable (n_rows, n_columns), windows (n_bands, CORNERS), least (n_bands), stumps
 * (n_bands, n_stumps). corner: index of pixel (0, 0) in the integral images, whose rows are `stride` long. at, score
 * (as many as windows may be centred, and one more): out, the survivors of all groups by band, row, column. band_stop
 * (n_bands): out, where each band's end. n_alive (n_groups): out. n_windows (1): out. Without groups windows are only
 * counted.
 */
void auv_mcm_cascade_open(int64_t n_rows, int64_t n_columns, int64_t stride, int64_t corner,
                          const uint32_t *restrict sums, const uint32_t *restrict counts,
                          const uint8_t *restrict usable, int64_t n_bands, const int32_t *restrict edges,
                          const int32_t *restrict windows, const int32_t *restrict least, int64_t n_stumps,
                          const Stump *restrict stumps, int64_t n_groups, const Group *restrict groups, int64_t restart,
                          int32_t *restrict at, int32_t *restrict score, int64_t *restrict band_stop,
                          int64_t *restrict n_alive, int64_t *restrict n_windows)
{
    int32_t block_score[BLOCK], alive[BLOCK];
    Segment segments[BLOCK / LANES];
    int64_t n = 0;
    memset(n_alive, 0, (size_t)n_groups * sizeof *n_alive);
    *n_windows = 0;
    for (int64_t band = 0; band < n_bands; band++) {
        const int32_t *window = windows + band * CORNERS, enough = least[band];
        int64_t n_segments = 0, filled = 0;
        for (int64_t row = 0; row < n_rows; row++) {
            const int32_t *edge = edges + row * (n_bands + 1) + band;
            for (int64_t column = edge[0]; column < edge[1]; column += SEGMENT) {
                Segment segment = {corner + row * stride + column,
                                   edge[1] - column < SEGMENT ? edge[1] - column : SEGMENT, 0};
                segment.padded = (segment.n + LANES - 1) / LANES * LANES;
                if (filled + segment.padded > BLOCK) {
                    n += open_block(sums, stumps + band * n_stumps, groups, n_groups, restart, n_segments, segments,
                                    block_score, alive, at + n, score + n, n_alive);
                    n_segments = filled = 0;
                }
                const int64_t found = find_windows(segment.n, counts + segment.at, window, enough,
                                                   usable + row * n_columns + column, alive + filled);
                *n_windows += found;
                if (!found || !n_groups)
                    continue;
                filled += segment.padded;
                segments[n_segments++] = segment;
            }
        }
        if (n_segments)
            n += open_block(sums, stumps + band * n_stumps, groups, n_groups, restart, n_segments, segments,
                            block_score, alive, at + n, score + n, n_alive);
        band_stop[band] = n;
    }
}

/* Runs groups [first, last) on the windows that auv_mcm_cascade_open left, or some of them; at, score, band_stop: in
 * and out. */
void auv_mcm_cascade_run(const uint32_t *restrict sums, int64_t n_bands, int64_t n_stumps, const Stump *restrict stumps,
                         int64_t first, int64_t last, const Group *restrict groups, int64_t restart,
                         int32_t *restrict at, int32_t *restrict score, int64_t *restrict band_stop,
                         int64_t *restrict n_alive)
{
    int64_t begin = 0, kept = 0;
    memset(n_alive, 0, (size_t)last * sizeof *n_alive);
    for (int64_t band = 0; band < n_bands; band++) {
        const int64_t stop = band_stop[band];
        const int64_t n = run_list(sums, stumps + band * n_stumps, groups, first, last, restart, stop - begin,
                                   at + begin, score + begin, n_alive);
        memmove(at + kept, at + begin, (size_t)n * sizeof *at);
        memmove(score + kept, score + begin, (size_t)n * sizeof *score);
        kept += n;
        begin = stop;
        band_stop[band] = kept;
    }
}

/* order (n): out, indices of scores from the highest down, of equal ones the first first: of the n_first (1 to n)
 * highest, and of all that equal the last of those. scratch (n): overwritten. n_ranked (1): out, how many.
 */
void auv_mcm_cascade_rank(int64_t n, const int32_t *restrict score, int64_t n_first, int32_t *order, int32_t *scratch,
                          int64_t *restrict n_ranked)
{
    int32_t highest = INT32_MIN, lowest = INT32_MAX;
    for (int64_t i = 0; i < n; i++) {
        highest = score[i] > highest ? score[i] : highest;
        lowest = score[i] < lowest ? score[i] : lowest;
    }
    /* Coarsely first, so that only those that may be among the first are sorted. */
    int64_t alike[1 << DIGIT_BITS] = {0}, some = 0, high = 0;
    uint32_t last = 0;
    int coarse = 0;
    while (((uint32_t)highest - (uint32_t)lowest) >> coarse >= 1 << DIGIT_BITS)
        coarse++;
    for (int64_t i = 0; i < n; i++)
        alike[((uint32_t)highest - (uint32_t)score[i]) >> coarse]++;
    while ((high += alike[last]) < n_first)
        last++;
    for (int64_t i = 0; i < n; i++) {
        order[some] = (int32_t)i;
        some += ((uint32_t)highest - (uint32_t)score[i]) >> coarse <= last;
    }
    int32_t *from = order, *to = scratch;
    for (int shift = 0; shift < 32; shift += DIGIT_BITS) {
        int64_t start[1 << DIGIT_BITS] = {0}, before = 0;
        for (int64_t i = 0; i < high; i++)
            start[((uint32_t)highest - (uint32_t)score[from[i]]) >> shift & ((1 << DIGIT_BITS) - 1)]++;
        if (start[0] == high)
            continue;
        for (int digit = 0; digit < 1 << DIGIT_BITS; digit++) {
            const int64_t equal = start[digit];
            start[digit] = before;
            before += equal;
        }
        for (int64_t i = 0; i < high; i++)
            to[start[((uint32_t)highest - (uint32_t)score[from[i]]) >> shift & ((1 << DIGIT_BITS) - 1)]++] = from[i];
        int32_t *const sorted = to;
        to = from;
        from = sorted;
    }
    if (from != order)
        memcpy(order, from, (size_t)high * sizeof *order);
    while (n_first < high && score[order[n_first]] == score[order[n_first - 1]])
        n_first++;
    *n_ranked = n_first;
}
