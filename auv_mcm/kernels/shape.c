/* Costs of solids as explanations of an image, see shape.py for their definition. */

#include "shape.h"

enum { VECTOR = 4 }; /* slices that wide vectors hold */

#define LEAST_MEAN 1e-6

/* Pixels and echoes of something. */
typedef struct {
    double count, sum;
} Echoes;

/* Of a row up to a column, linear within a pixel. counts: NULL where every pixel counts. */
static inline Echoes up_to(const double *counts, const double *echoes, double column, int64_t n_columns)
{
    const int64_t left = column < (double)(n_columns - 1) ? (int64_t)column : n_columns - 1;
    const double part = column - (double)left;
    const double count = counts ? counts[left] + (counts[left + 1] - counts[left]) * part : column;
    const Echoes found = {count, echoes[left] + (echoes[left + 1] - echoes[left]) * part};
    return found;
}

static inline void gather(Echoes *into, Echoes from, Echoes to)
{
    into->count += to.count - from.count;
    into->sum += to.sum - from.sum;
}

/* Adds a row's stretches to what is known of each mixture. at (n): columns where stretches end; found (n): of the row
 * up to them. */
static void mix_row(const double *at, const int *code, int n, const Echoes *found, Echoes *mixture)
{
    int order[N_ENDS * MAX_TAPS], now = 0;

    for (int i = 0; i < n; i++) {
        int place = i;
        for (; place > 0 && at[order[place - 1]] > at[i]; place--)
            order[place] = order[place - 1];
        order[place] = i;
    }
    int before = order[0];
    for (int i = 0; i + 1 < n; i++) {
        now += code[order[i]];
        if (at[order[i + 1]] <= at[order[i]])
            continue;
        gather(mixture + now, found[before], found[order[i + 1]]);
        before = order[i + 1];
    }
}

static inline int is_contrasting(const double *mean) { return mean[1] <= 0.6 * mean[2] && mean[0] >= 1.3 * mean[2]; }

static inline double misfit(double count, double sum, double mean) { return count * log(mean) + sum / mean - count; }

/* Mixtures that hold anything. share (3, n): of highlight, shadow and floor. */
typedef struct {
    int64_t n;
    double count[MIXTURES], sum[MIXTURES], share[3][MIXTURES];
} Mixtures;

/* One step of Fisher scoring for the logarithms of the means of highlight, shadow and floor. */
WIDE static void improve(const Mixtures *mixtures, double *mean)
{
    double h[3][3] = {{0.0}}, g[3] = {0.0}, part[3][MIXTURES], surprise[MIXTURES];

    for (int64_t i = 0; i < mixtures->n; i++) {
        const double bright = mixtures->share[0][i] * mean[0], dark = mixtures->share[1][i] * mean[1],
                     rest = mixtures->share[2][i] * mean[2];
        const double scale = 1.0 / (bright + dark + rest);
        surprise[i] = mixtures->sum[i] * scale - mixtures->count[i];
        part[0][i] = bright * scale;
        part[1][i] = dark * scale;
        part[2][i] = rest * scale;
    }
    for (int64_t i = 0; i < mixtures->n; i++) {
        const double a = part[0][i], b = part[1][i], c = part[2][i], count = mixtures->count[i];
        g[0] += a * surprise[i];
        g[1] += b * surprise[i];
        g[2] += c * surprise[i];
        h[0][0] += count * a * a;
        h[1][0] += count * b * a;
        h[1][1] += count * b * b;
        h[2][0] += count * c * a;
        h[2][1] += count * c * b;
        h[2][2] += count * c * c;
    }
    const double ridge = 1e-9 * (h[0][0] + h[1][1] + h[2][2]) + 1e-12;
    for (int j = 0; j < 3; j++)
        h[j][j] += ridge;
    /* L D L' without pivoting: h is positive definite. */
    const double l10 = h[1][0] / h[0][0], l20 = h[2][0] / h[0][0], d1 = h[1][1] - l10 * h[1][0];
    const double l21 = (h[2][1] - l20 * h[1][0]) / d1, d2 = h[2][2] - l20 * h[2][0] - l21 * l21 * d1;
    const double y1 = g[1] - l10 * g[0], y2 = g[2] - l20 * g[0] - l21 * y1;
    double step[3];
    step[2] = y2 / d2;
    step[1] = y1 / d1 - l21 * step[2];
    step[0] = g[0] / h[0][0] - l10 * step[1] - l20 * step[2];
    for (int j = 0; j < 3; j++)
        mean[j] = larger(mean[j] * exp(clamp(step[j], -1.0, 1.0)), LEAST_MEAN);
}

/* Up to which columns the pixels of a row count; NULL where all do. */
static inline const double *counts_of(const Image *image, int64_t row)
{
    const double *counts = image->counts + row * (image->n_columns + 1);
    return image->is_whole || counts[image->n_columns] == (double)image->n_columns ? 0 : counts;
}

/* Adds highlight and shadow of slices, one a row from the first. */
static void add_rows(const Image *image, int64_t first, int64_t n_rows, const Slices *slices, Echoes *part)
{
    for (int64_t k = 0; k < n_rows; k++) {
        if (!slices->hit[k])
            continue;
        const double *counts = counts_of(image, first + k);
        const double *echoes = image->echoes + (first + k) * (image->n_columns + 1);
        const Echoes front = up_to(counts, echoes, slices->end[0][k], image->n_columns),
                     between = up_to(counts, echoes, slices->end[1][k], image->n_columns);
        gather(part, front, between);
        gather(part + 1, between, up_to(counts, echoes, slices->end[2][k], image->n_columns));
    }
}

double shape_cost_of(int64_t kind, const double *hypothesis, const Image *image, const Beam *beam, double *mean)
{
    static const int DIGIT[MAX_TAPS] = {1, 3, 9};
    const double *solid = hypothesis + 3, along = hypothesis[0], y = hypothesis[1],
                 altitude = image->altitude * hypothesis[2];
    const double slant = sqrt(y * y + altitude * altitude);
    const int middle = beam->n_taps / 2, n_mixtures = beam->n_taps > 1 ? MIXTURES : 3;
    Echoes part[3] = {{0.0, 0.0}}, mixture[MIXTURES]; /* highlight, shadow and floor as the middle slice has them */
    double spread = 0.0, cost = 0.0;
    Placed placed;
    Slices slices;

    shape_place(kind, solid, &placed);
    if (!(y > placed.reach * (1.0 + fabs(image->shear)) && altitude >= 1.2 * placed.top && placed.top > 0.0))
        return FORBIDDEN;
    for (int tap = 0; tap < beam->n_taps; tap++)
        spread = larger(spread, fabs(beam->angle[tap]) * slant);
    for (int i = 0; i < n_mixtures; i++)
        mixture[i].count = mixture[i].sum = 0.0;
    const double low = (along - placed.reach - spread) / image->row_m - 1.0,
                 high = (along + placed.reach + spread) / image->row_m + 1.0;
    const int64_t first = (int64_t)clamp(low, 0.0, (double)image->n_rows),
                  stop = (int64_t)clamp(high, 0.0, (double)image->n_rows);

    for (int64_t block = first; block < stop; block += BLOCK / MAX_TAPS) {
        const int64_t n_rows = block + BLOCK / MAX_TAPS < stop ? BLOCK / MAX_TAPS : stop - block;

        slices.n = 0;
        for (int64_t row = block; row < block + n_rows; row++) {
            const double u = ((double)row + 0.5) * image->row_m - along;
            for (int tap = 0; tap < beam->n_taps; tap++) {
                const double off = u + beam->angle[tap] * slant;
                slices.u[slices.n] = off;
                slices.y[slices.n++] = y - off * image->shear;
            }
        }
        /* To whole vectors, with copies of the last slice. */
        for (; kind != WEDGE && slices.n % VECTOR > 0; slices.n++) {
            slices.u[slices.n] = slices.u[slices.n - 1];
            slices.y[slices.n] = slices.y[slices.n - 1];
        }
        shape_cut(kind, solid, &placed, image, altitude, &slices);
        if (beam->n_taps == 1)
            add_rows(image, block, n_rows, &slices, part);
        for (int64_t k = 0; beam->n_taps > 1 && k < n_rows; k++) {
            const double *echoes = image->echoes + (block + k) * (image->n_columns + 1);
            const double *counts = counts_of(image, block + k);
            double at[N_ENDS * MAX_TAPS];
            Echoes found[N_ENDS * MAX_TAPS];
            int code[N_ENDS * MAX_TAPS], n = 0;

            for (int tap = 0; tap < beam->n_taps; tap++) {
                const int64_t i = k * beam->n_taps + tap;
                if (!slices.hit[i])
                    continue;
                for (int end = 0; end < N_ENDS; end++) {
                    at[n + end] = slices.end[end][i];
                    found[n + end] = up_to(counts, echoes, at[n + end], image->n_columns);
                    code[n + end] = end < 2 ? DIGIT[tap] : -2 * DIGIT[tap];
                }
                if (tap == middle) {
                    gather(part, found[n], found[n + 1]);
                    gather(part + 1, found[n + 1], found[n + 2]);
                }
                n += N_ENDS;
            }
            if (n > 0)
                mix_row(at, code, n, found, mixture);
        }
    }
    part[2].count = image->n_total - part[0].count - part[1].count;
    part[2].sum = image->total - part[0].sum - part[1].sum;
    for (int k = 0; k < 3; k++)
        mean[k] = larger(part[k].count > 0.0 ? part[k].sum / part[k].count : 0.0, LEAST_MEAN);
    if (!(part[0].count >= 4.0 && part[1].count >= 8.0 && part[2].count >= 1.0))
        return FORBIDDEN;
    if (beam->n_taps > 1) {
        mixture[0].count = image->n_total;
        mixture[0].sum = image->total;
        for (int i = 1; i < n_mixtures; i++) {
            mixture[0].count -= mixture[i].count;
            mixture[0].sum -= mixture[i].sum;
        }
        Mixtures held;
        held.n = 0;
        for (int i = 0; i < n_mixtures; i++) {
            if (!(mixture[i].count > 0.0 || mixture[i].sum > 0.0))
                continue;
            held.count[held.n] = mixture[i].count;
            held.sum[held.n] = mixture[i].sum;
            held.share[0][held.n] = beam->share[i][0];
            held.share[1][held.n] = beam->share[i][1];
            held.share[2][held.n++] = 1.0 - beam->share[i][0] - beam->share[i][1];
        }
        for (int64_t step = 0; step < beam->n_steps; step++)
            improve(&held, mean);
        if (!is_contrasting(mean))
            return FORBIDDEN;
        for (int64_t i = 0; i < held.n; i++)
            cost += misfit(held.count[i], held.sum[i],
                           held.share[0][i] * mean[0] + held.share[1][i] * mean[1] + held.share[2][i] * mean[2]);
    } else {
        if (!is_contrasting(mean))
            return FORBIDDEN;
        for (int k = 0; k < 3; k++)
            cost += misfit(part[k].count, part[k].sum, mean[k]);
    }
    return image->weight * cost;
}

Beam shape_beam_of(int64_t n_taps, const double *angle, const double *share, int64_t n_steps)
{
    Beam beam = {(int)n_taps, n_steps, angle, {{0.0}}};
    for (int i = 0; i < MIXTURES; i++) {
        int code = i;
        for (int tap = 0; tap < beam.n_taps; tap++, code /= 3)
            if (code % 3 > 0)
                beam.share[i][code % 3 - 1] += share[tap];
    }
    return beam;
}

Image shape_image_of(int64_t n_rows, int64_t n_columns, const double *scalars, const double *echoes,
                     const double *counts)
{
    Image image = {n_rows,     n_columns,  scalars[0], scalars[1], scalars[2], scalars[3], scalars[4],
                   scalars[5], scalars[6], echoes,     counts,     0.0,        0.0,        0};
    for (int64_t row = 0; row < n_rows; row++) {
        image.total += echoes[row * (n_columns + 1) + n_columns];
        image.n_total += counts[row * (n_columns + 1) + n_columns];
    }
    image.is_whole = image.n_total == (double)n_rows * (double)n_columns;
    return image;
}

/* hypotheses (n, 8), echoes and counts (n_rows, n_columns + 1), scalars: row, column, first ground range, altitude in
 * metres, independent samples per pixel, smear in metres, shear. angle, share (n_taps), one or three. cost (n), mean
 * (n, 3).
 */
void auv_mcm_shape_costs(int64_t kind, int64_t n, const double *hypotheses, int64_t n_rows, int64_t n_columns,
                         const double *scalars, const double *echoes, const double *counts, int64_t n_taps,
                         const double *angle, const double *share, int64_t n_steps, double *cost, double *mean)
{
    const Image image = shape_image_of(n_rows, n_columns, scalars, echoes, counts);
    const Beam beam = shape_beam_of(n_taps, angle, share, n_steps);

    for (int64_t i = 0; i < n; i++) {
        cost[i] = shape_cost_of(kind, hypotheses + FIELDS * i, &image, &beam, mean + 3 * i);
        if (cost[i] >= FORBIDDEN)
            mean[3 * i] = mean[3 * i + 1] = mean[3 * i + 2] = NAN;
    }
}

/* ends (n, n_rows, n_taps, 3): columns as shape_cut() finds them, 0 where it finds none. The rest as above. */
void auv_mcm_shape_intervals(int64_t kind, int64_t n, const double *hypotheses, int64_t n_rows, int64_t n_columns,
                             const double *scalars, int64_t n_taps, const double *angle, double *ends)
{
    const Image image = {n_rows,     n_columns,  scalars[0], scalars[1], scalars[2], scalars[3], scalars[4],
                         scalars[5], scalars[6], 0,          0,          0.0,        0.0,        0};

    for (int64_t i = 0; i < n; i++) {
        const double *hypothesis = hypotheses + FIELDS * i, *solid = hypothesis + 3, y = hypothesis[1];
        const double altitude = image.altitude * hypothesis[2], slant = sqrt(y * y + altitude * altitude);
        Placed placed;
        Slices slices;
        shape_place(kind, solid, &placed);
        for (int64_t slot = 0; slot < n_rows * n_taps; slot += slices.n) {
            slices.n = slot + BLOCK < n_rows * n_taps ? BLOCK : n_rows * n_taps - slot;
            for (int64_t k = 0; k < slices.n; k++) {
                const int64_t row = (slot + k) / n_taps, tap = (slot + k) % n_taps;
                slices.u[k] = ((double)row + 0.5) * image.row_m - hypothesis[0] + angle[tap] * slant;
                slices.y[k] = y - slices.u[k] * image.shear;
            }
            shape_cut(kind, solid, &placed, &image, altitude, &slices);
            for (int64_t k = 0; k < slices.n; k++)
                for (int end = 0; end < N_ENDS; end++)
                    *ends++ = slices.hit[k] ? slices.end[end][k] : 0.0;
        }
    }
}
