/* The search for the solid that costs least, see shape_walk.py. */

#include "shape.h"

enum { SUNK = 7, RATIO = 8, N_FACTORS = 9 };

/* What a class's points stand for, see shape_walk.py. */
typedef struct {
    int64_t n_dimensions;
    const double *low, *span, *wraps, *term;
    double altitude_sigma, burial_sigma, fixed;
} Chart;

/* As in Python, with the sign of the divisor. */
static inline double modulo(double value, double divisor)
{
    const double rest = fabs(value) < divisor ? value : fmod(value, divisor);
    return rest < 0.0 ? rest + divisor : rest;
}

static inline double folded(double unit, double wraps)
{
    return wraps != 0.0 ? modulo(unit, 1.0) : 1.0 - fabs(1.0 - modulo(unit, 2.0));
}

static double cost_at(const double *unit, const Chart *chart, int64_t kind, const Image *image, const Beam *beam)
{
    double factor[N_FACTORS] = {1.0}, hypothesis[FIELDS], mean[3];

    for (int64_t k = 0; k < chart->n_dimensions; k++)
        factor[1 + k] = chart->low[k] + folded(unit[k], chart->wraps[k]) * chart->span[k];
    const double last = factor[chart->n_dimensions];
    factor[SUNK] = larger(last, 0.0);
    factor[RATIO] = 1.0 + smaller(last, 0.0);
    for (int j = 0; j < FIELDS; j++) {
        const double *term = chart->term + 3 * j;
        hypothesis[j] = term[0] * factor[(int)term[1]] * factor[(int)term[2]];
    }
    const double altitude = (hypothesis[2] - 1.0) / chart->altitude_sigma, burial = factor[SUNK] / chart->burial_sigma;
    return shape_cost_of(kind, hypothesis, image, beam, mean) + 0.5 * (altitude * altitude + burial * burial) +
           chart->fixed;
}

/* The index of the lowest cost after the one at `last`, the first of equals; n if there is none. last: -1 for the
 * lowest of all. */
static int64_t next_best(int64_t n, const double *cost, int64_t last)
{
    int64_t found = n;
    for (int64_t i = 0; i < n; i++) {
        const int is_after = last < 0 || cost[i] > cost[last] || (cost[i] == cost[last] && i > last);
        if (is_after && (found == n || cost[i] < cost[found]))
            found = i;
    }
    return found;
}

/* Whether a place differs from another by more than `apart` of the box in some coordinate. */
static int is_apart(const double *a, const double *b, const Chart *chart, double apart)
{
    for (int64_t k = 0; k < chart->n_dimensions; k++) {
        const double away = fabs(a[k] - b[k]);
        if ((chart->wraps[k] != 0.0 ? smaller(away, 1.0 - away) : away) > apart)
            return 1;
    }
    return 0;
}

/* Out of n starts the n_kept best that are apart from every better one; each then takes the best of n_tries steps if
 * that is better, n_steps times. Returns through n_found how many there are, best first.
 *
 * box (4, n_dimensions): low, span, wraps, one grain over the span. term (8, 3). scalars: as above, then sigmas of
 * altitude and burial and what every point costs. start (n, n_dimensions), cost (n): ranks; computed first unless
 * is_known, then computed anew for those kept if is_known is 1. strides: first, growth, shrinkage, least; how far
 * starts are apart. way (n_steps, n_tries, n_dimensions). unit (n_kept, n_dimensions), best (n_kept): out.
 */
void auv_mcm_shape_search(int64_t kind, int64_t n, int64_t n_dimensions, const double *box, const double *term,
                          int64_t n_rows, int64_t n_columns, const double *scalars, const double *echoes,
                          const double *counts, int64_t n_taps, const double *angle, const double *share,
                          int64_t n_scoring_steps, const double *start, double *cost, int64_t is_known, int64_t n_kept,
                          const double *strides, int64_t n_steps, int64_t n_tries, const double *way, double *unit,
                          double *best, int64_t *n_found)
{
    const Image image = shape_image_of(n_rows, n_columns, scalars, echoes, counts);
    const Beam beam = shape_beam_of(n_taps, angle, share, n_scoring_steps);
    const Chart chart = {n_dimensions, box,        box + n_dimensions, box + 2 * n_dimensions,
                         term,         scalars[7], scalars[8],         scalars[9]};
    const double *grain = box + 3 * n_dimensions;
    const size_t size = (size_t)n_dimensions * sizeof *unit;
    int64_t kept = 0;

    for (int64_t i = 0; !is_known && i < n; i++)
        cost[i] = cost_at(start + i * n_dimensions, &chart, kind, &image, &beam);
    for (int64_t i = next_best(n, cost, -1); i < n && kept < n_kept; i = next_best(n, cost, i)) {
        int is_new = 1;
        for (int64_t k = 0; k < kept && is_new; k++)
            is_new = is_apart(unit + k * n_dimensions, start + i * n_dimensions, &chart, strides[4]);
        if (is_new) {
            memcpy(unit + kept * n_dimensions, start + i * n_dimensions, size);
            best[kept++] = cost[i];
        }
    }
    *n_found = kept;
    for (int64_t i = 0; i < kept; i++) {
        double stride = strides[0], *here = unit + i * n_dimensions;
        if (is_known == 1)
            best[i] = cost_at(here, &chart, kind, &image, &beam);
        for (int64_t step = 0; step < n_steps; step++) {
            double lowest = INFINITY, chosen[N_FACTORS], there[N_FACTORS];
            for (int64_t k = 0; k < n_tries; k++) {
                const double *towards = way + (step * n_tries + k) * n_dimensions;
                for (int64_t j = 0; j < n_dimensions; j++)
                    there[j] = here[j] + stride * (grain[j] * towards[j]);
                const double found = cost_at(there, &chart, kind, &image, &beam);
                if (found < lowest) {
                    lowest = found;
                    memcpy(chosen, there, sizeof chosen);
                }
            }
            const int better = lowest < best[i];
            if (better) {
                memcpy(here, chosen, size);
                best[i] = lowest;
            }
            stride = larger(stride * (better ? strides[1] : strides[2]), strides[3]);
        }
        for (int64_t k = 0; k < n_dimensions; k++)
            here[k] = folded(here[k], chart.wraps[k]);
    }
    for (int64_t i = 1; i < kept; i++) { /* best first, equals in order */
        double here[N_FACTORS];
        const double value = best[i];
        int64_t k = i;
        memcpy(here, unit + i * n_dimensions, size);
        for (; k > 0 && best[k - 1] > value; k--) {
            memcpy(unit + k * n_dimensions, unit + (k - 1) * n_dimensions, size);
            best[k] = best[k - 1];
        }
        memcpy(unit + k * n_dimensions, here, size);
        best[k] = value;
    }
}
