/* Polygons that may be moved, see is_sound in snake_twin.py. */

#include "snake.h"

static double turn(const double *a, const double *b, const double *c)
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

static inline int sign(double value) { return (value > 0.0) - (value < 0.0); }

static int on_segment(const double *a, const double *b, const double *p)
{
    return fmin(a[0], b[0]) <= p[0] && p[0] <= fmax(a[0], b[0]) && fmin(a[1], b[1]) <= p[1] && p[1] <= fmax(a[1], b[1]);
}

static int meet(const double *a, const double *b, const double *c, const double *d)
{
    if (fmax(a[0], b[0]) < fmin(c[0], d[0]) || fmax(c[0], d[0]) < fmin(a[0], b[0]))
        return 0;
    if (fmax(a[1], b[1]) < fmin(c[1], d[1]) || fmax(c[1], d[1]) < fmin(a[1], b[1]))
        return 0;
    const int c_side = sign(turn(a, b, c)), d_side = sign(turn(a, b, d));
    const int a_side = sign(turn(c, d, a)), b_side = sign(turn(c, d, b));
    if (c_side * d_side < 0 && a_side * b_side < 0)
        return 1;
    return (c_side == 0 && on_segment(a, b, c)) || (d_side == 0 && on_segment(a, b, d)) ||
           (a_side == 0 && on_segment(c, d, a)) || (b_side == 0 && on_segment(c, d, b));
}

/* Whether edges [first, first + n_edges) of a polygon, the others being sound, leave it simple, with nodes apart and
 * crossed twice by every row. */
int snake_sound(const double (*node)[2], int64_t n, int64_t first, int64_t n_edges)
{
    int changes = 0, before = 0, initial = 0;
    for (int64_t i = 0; i < n; i++) {
        const int way = sign(node[i + 1 < n ? i + 1 : 0][0] - node[i][0]);
        if (way == 0)
            continue;
        if (initial == 0)
            initial = way;
        changes += before != 0 && way != before;
        before = way;
    }
    if (changes + (before != initial) > 2)
        return 0;
    for (int64_t k = 0; k < n_edges; k++) {
        const int64_t i = (first + k) % n, next = (i + 1) % n;
        const double *a = node[i], *b = node[next];
        const double row = b[0] - a[0], column = b[1] - a[1];
        if (row * row + column * column < 0.25)
            return 0;
        for (int64_t j = 0; j < n; j++) {
            const double *c = node[j], *d = node[(j + 1) % n];
            if (j == i)
                continue;
            if (j == next) { /* adjacent: only folding back is wrong */
                if (turn(a, b, d) == 0.0 && row * (d[0] - c[0]) + column * (d[1] - c[1]) < 0.0)
                    return 0;
            } else if ((j + 1) % n == i) {
                if (turn(c, a, b) == 0.0 && row * (a[0] - c[0]) + column * (a[1] - c[1]) < 0.0)
                    return 0;
            } else if (meet(a, b, c, d)) {
                return 0;
            }
        }
    }
    return 1;
}
