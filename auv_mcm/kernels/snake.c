/* A highlight and a shadow polygon moved together over row cumulative sums, see snake.py for the definitions and the
 * numpy twin.
 *
 * Sums, counts and node coordinates are dyadic fractions that doubles hold exactly, so totals may be updated by
 * differences without drift and every decision equals the twin's. Logarithms come from the C library that Python's own
 * math.log calls.
 */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX_NODES 64
#define N_FIELDS 8
#define HIGHLIGHT 0
#define SHADOW 1
#define BACKGROUND 2
#define LEAST_SIDE 4.0 /* pixels, of a box */
#define LEAST_ROWS 3   /* in which pixels must have been measured */

/* What an edge, and by summation a polygon, adds up over the rows it crosses; the order is that of snake.py. */
enum { SUM, COUNT, AREA, FAR, ROWS, GAP, SHARED, OVERLAP };

/* The order of `Settings` in snake.py. */
typedef struct {
    double row_spacing_m, column_spacing_m, first_ground_range_m, altitude_m, correlation_px;
    double extent_tolerance_m, extent_sigma_m, gap_tolerance_m, gap_sigma_m;
    double height_limit_m, height_sigma_m, height_bound_m, min_area_px, faintest, dimmest_highlight, brightest_shadow,
        forbidden;
    double window_sum, window_count, log_window;
} settings;

typedef struct {
    int64_t n;
    double node[MAX_NODES][2];
    double edge[MAX_NODES][N_FIELDS];
    double total[N_FIELDS];
    double step[2]; /* summed |difference| of rows and of columns between adjacent nodes */
    double own;     /* its part of the criterion */
    double top, bottom, near;
    int64_t tried[MAX_NODES]; /* the pair's n_changes when no way of a node was better: as long as nothing changes none
                                 will be */
} polygon;

typedef struct {
    int64_t n_rows, n_columns;
    const double *table;
    const settings *set;
    double *bound; /* per row, the other polygon's side that faces this one; -1 where it has none */
    polygon part[2];
    int64_t n_evaluated;
    int64_t n_accepted;
    int64_t n_changes; /* of nodes or of the length of moves, from 1 */
} pair;

static inline int64_t ceil_of(double value)
{
    const int64_t whole = (int64_t)value;
    return (double)whole < value ? whole + 1 : whole;
}

static inline int64_t clip(int64_t value, int64_t highest) { return value < 0 ? 0 : value > highest ? highest : value; }

/* First row an edge crosses in *start, one past the last in *stop; its column at row centre r + 0.5 is column + (r +
 * 0.5 - row) * slope. */
typedef struct {
    int64_t start, stop;
    double row, column, slope;
} crossing;

static inline crossing crossed(const pair *pair, const double *a, const double *b)
{
    const double *upper = a[0] < b[0] ? a : b, *lower = a[0] < b[0] ? b : a;
    crossing edge = {0, 0, upper[0], upper[1], 0.0};
    if (a[0] == b[0])
        return edge;
    edge.start = clip(ceil_of(upper[0] - 0.5), pair->n_rows);
    edge.stop = clip(ceil_of(lower[0] - 0.5), pair->n_rows);
    edge.slope = (lower[1] - upper[1]) / (lower[0] - upper[0]);
    return edge;
}

static inline int64_t column_at(const crossing *edge, int64_t row, int64_t n_columns)
{
    return clip(ceil_of(edge->column + ((double)row + 0.5 - edge->row) * edge->slope - 0.5), n_columns);
}

static void measure_edge(const pair *pair, int which, const double *a, const double *b, double *field)
{
    const crossing edge = crossed(pair, a, b);
    const int downward = b[0] > a[0];
    const int facing = downward == (which == HIGHLIGHT);
    double sum = 0.0, count = 0.0, gap = 0.0, shared = 0.0, overlap = 0.0;
    int64_t columns = 0;

    for (int64_t row = edge.start; row < edge.stop; row++) {
        const int64_t column = column_at(&edge, row, pair->n_columns);
        const double *cell = pair->table + 2 * (row * (pair->n_columns + 1) + column);
        sum += cell[0];
        count += cell[1];
        columns += column;
        if (facing && pair->bound[row] >= 0.0) {
            const double between = which == HIGHLIGHT ? pair->bound[row] - (double)column
                                                      : (double)column - pair->bound[row];
            gap += between > 0.0 ? between : 0.0;
            overlap += between < 0.0 ? -between : 0.0;
            shared += 1.0;
        }
    }
    field[SUM] = downward ? sum : -sum;
    field[COUNT] = downward ? count : -count;
    field[AREA] = (double)(downward ? columns : -columns);
    field[FAR] = downward ? (double)columns : 0.0;
    field[ROWS] = downward && edge.stop > edge.start ? (double)(edge.stop - edge.start) : 0.0;
    field[GAP] = gap;
    field[SHARED] = shared;
    field[OVERLAP] = overlap;
}

/* side: HIGHLIGHT and SHADOW have means beyond a bound; any other number is free. */
static double likelihood(const settings *set, int side, double sum, double count)
{
    const double mean = sum / count;
    double best = mean > set->faintest ? mean : set->faintest;
    if (side == HIGHLIGHT && best < set->dimmest_highlight)
        best = set->dimmest_highlight;
    if (side == SHADOW && best > set->brightest_shadow)
        best = set->brightest_shadow;
    return count * (log(best) + (mean / best - 1.0)) / set->correlation_px;
}

static double parameter_code(const settings *set, double count)
{
    const double samples = count / set->correlation_px;
    return samples > 1.0 ? 0.5 * log(samples) : 0.0;
}

static double polygon_cost(const settings *set, int which, double n, const double *total, const double *step)
{
    const double rows = step[0] / n, columns = step[1] / n;
    const double cells = rows * columns / set->correlation_px;
    const double spread = log(cells > 0.25 ? cells : 0.25);
    const double code = set->log_window + 2.0 * log(n) + n * (2.0 * 1.6931471805599454 + spread);
    return likelihood(set, which, total[SUM], total[COUNT]) + code + parameter_code(set, total[COUNT]);
}

static inline double beyond(double excess_m, double sigma_m)
{
    const double deviation = excess_m > 0.0 ? excess_m / sigma_m : 0.0;
    return 0.5 * deviation * deviation;
}

static double height_m(const settings *set, const double *total)
{
    const double far_m = set->first_ground_range_m + total[FAR] / total[ROWS] * set->column_spacing_m;
    const double near_m = far_m - total[AREA] / total[ROWS] * set->column_spacing_m;
    const double up = set->altitude_m;
    return up * (1.0 - sqrt(near_m * near_m + up * up) / sqrt(far_m * far_m + up * up));
}

/* Shape of one polygon as the rest of the criterion sees it. */
typedef struct {
    const double *total;
    double own, top, bottom, near;
} shape;

static double shadow_cost(const settings *set, const shape *shadow)
{
    const double height = height_m(set, shadow->total);
    double cost = beyond(height - set->height_limit_m, set->height_sigma_m);
    if (height > set->height_bound_m)
        cost += set->forbidden * (height - set->height_bound_m);
    return cost;
}

static double cooperation(const settings *set, const shape *highlight, const shape *shadow, const double *moved)
{
    const double top_m = fabs(highlight->top - shadow->top) * set->row_spacing_m;
    const double bottom_m = fabs(highlight->bottom - shadow->bottom) * set->row_spacing_m;
    double cost = beyond(top_m - set->extent_tolerance_m, set->extent_sigma_m);
    cost += beyond(bottom_m - set->extent_tolerance_m, set->extent_sigma_m);
    if (moved[SHARED] > 0.0)
        cost += beyond(moved[GAP] / moved[SHARED] * set->column_spacing_m - set->gap_tolerance_m, set->gap_sigma_m);
    else
        cost += set->forbidden;
    cost += set->forbidden * moved[OVERLAP];
    if (shadow->near < highlight->near)
        cost += set->forbidden * (highlight->near - shadow->near);
    return cost;
}

/* The criterion with `moved` in the place of polygon `which`. */
static double criterion(const pair *pair, int which, const shape *moved)
{
    const settings *set = pair->set;
    const polygon *fixed = &pair->part[1 - which];
    const shape other = {fixed->total, fixed->own, fixed->top, fixed->bottom, fixed->near};
    const shape *highlight = which == HIGHLIGHT ? moved : &other, *shadow = which == HIGHLIGHT ? &other : moved;
    const int both = fixed->n > 0;
    double sum = set->window_sum - moved->total[SUM], count = set->window_count - moved->total[COUNT];
    double cost = moved->own;

    if (both) {
        sum -= fixed->total[SUM];
        count -= fixed->total[COUNT];
        cost = highlight->own + shadow->own;
    }
    if (count >= 1.0)
        cost += likelihood(set, BACKGROUND, sum, count) + parameter_code(set, count);
    if (both || which == SHADOW)
        cost += shadow_cost(set, shadow);
    if (both)
        cost += cooperation(set, highlight, shadow, moved->total);
    return cost;
}

static void extents(const double (*node)[2], int64_t n, double *top, double *bottom, double *near)
{
    *top = *bottom = node[0][0];
    *near = node[0][1];
    for (int64_t i = 1; i < n; i++) {
        *top = node[i][0] < *top ? node[i][0] : *top;
        *bottom = node[i][0] > *bottom ? node[i][0] : *bottom;
        *near = node[i][1] < *near ? node[i][1] : *near;
    }
}

/* The side of the other polygon that faces polygon `which`, per row. */
static void find_bound(pair *pair, int which)
{
    const polygon *other = &pair->part[1 - which];
    const int downward = which == SHADOW; /* the shadow faces the far side of the highlight */

    for (int64_t row = 0; row < pair->n_rows; row++)
        pair->bound[row] = -1.0;
    for (int64_t i = 0; i < other->n; i++) {
        const double *a = other->node[i], *b = other->node[(i + 1) % other->n];
        if (a[0] == b[0] || (b[0] > a[0]) != downward)
            continue;
        const crossing edge = crossed(pair, a, b);
        for (int64_t row = edge.start; row < edge.stop; row++)
            pair->bound[row] = (double)column_at(&edge, row, pair->n_columns);
    }
}

/* Everything that is known of a polygon from its nodes and from `bound`. */
static void measure(pair *pair, int which)
{
    polygon *part = &pair->part[which];
    memset(part->total, 0, sizeof part->total);
    part->step[0] = part->step[1] = 0.0;
    for (int64_t i = 0; i < part->n; i++) {
        const double *a = part->node[i], *b = part->node[(i + 1) % part->n];
        measure_edge(pair, which, a, b, part->edge[i]);
        for (int field = 0; field < N_FIELDS; field++)
            part->total[field] += part->edge[i][field];
        part->step[0] += fabs(b[0] - a[0]);
        part->step[1] += fabs(b[1] - a[1]);
    }
    part->own = polygon_cost(pair->set, which, (double)part->n, part->total, part->step);
    extents(part->node, part->n, &part->top, &part->bottom, &part->near);
}

static double refresh(pair *pair, int which)
{
    const polygon *part = &pair->part[which];
    measure(pair, which);
    const shape whole = {part->total, part->own, part->top, part->bottom, part->near};
    return criterion(pair, which, &whole);
}

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
static int sound(const double (*node)[2], int64_t n, int64_t first, int64_t n_edges)
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

/* Nodes first .. first + n_moved - 1 shifted by (row, column): the criterion if that is better than `best` and allowed,
 * else `best`. */
static double try_shift(pair *pair, int which, int64_t first, int64_t n_moved, double row, double column, double best)
{
    polygon *part = &pair->part[which];
    const int64_t n = part->n, before = (first + n - 1) % n;
    double saved[2][2], total[N_FIELDS], field[N_FIELDS], step[2] = {part->step[0], part->step[1]};
    double found = best;

    for (int64_t k = 0; k < n_moved; k++) {
        const double *node = part->node[(first + k) % n];
        const double to[2] = {node[0] + row, node[1] + column};
        if (to[0] < 0.0 || to[0] > (double)pair->n_rows || to[1] < 0.0 || to[1] > (double)pair->n_columns)
            return best;
    }
    pair->n_evaluated++;
    memcpy(total, part->total, sizeof total);
    for (int64_t k = 0; k <= n_moved; k++) {
        const int64_t i = (before + k) % n;
        const double *a = part->node[i], *b = part->node[(i + 1) % n];
        step[0] -= fabs(b[0] - a[0]);
        step[1] -= fabs(b[1] - a[1]);
    }
    for (int64_t k = 0; k < n_moved; k++) {
        double *node = part->node[(first + k) % n];
        memcpy(saved[k], node, sizeof saved[k]);
        node[0] += row;
        node[1] += column;
    }
    for (int64_t k = 0; k <= n_moved; k++) {
        const int64_t i = (before + k) % n;
        const double *a = part->node[i], *b = part->node[(i + 1) % n];
        measure_edge(pair, which, a, b, field);
        for (int f = 0; f < N_FIELDS; f++)
            total[f] += field[f] - part->edge[i][f];
        step[0] += fabs(b[0] - a[0]);
        step[1] += fabs(b[1] - a[1]);
    }
    if (total[COUNT] >= 1.0 && total[AREA] >= pair->set->min_area_px) {
        shape moved = {total, polygon_cost(pair->set, which, (double)n, total, step), 0.0, 0.0, 0.0};
        extents(part->node, n, &moved.top, &moved.bottom, &moved.near);
        const double cost = criterion(pair, which, &moved);
        if (cost < best && sound(part->node, n, before, n_moved + 1))
            found = cost;
    }
    for (int64_t k = 0; k < n_moved; k++)
        memcpy(part->node[(first + k) % n], saved[k], sizeof saved[k]);
    return found;
}

/* Directions of a node, then of an edge: (row, column). */
static const double WAYS[12][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-1, -1}, {-1, 1},
                                   {1, -1}, {1, 1}, {-1, 0}, {1, 0}, {0, -1},  {0, 1}};

/* Each node, and the edge after it, goes the best way of all unless it is settled; returns how many moved. */
static int64_t sweep(pair *pair, int which, double amplitude, double *cost)
{
    polygon *part = &pair->part[which];
    int64_t n_moved = 0;

    if (part->n == 0)
        return 0;
    find_bound(pair, which);
    *cost = refresh(pair, which);
    for (int64_t i = 0; i < part->n; i++) {
        int chosen = -1;
        if (part->tried[i] == pair->n_changes)
            continue;
        for (int way = 0; way < 12; way++) {
            const double found = try_shift(pair, which, i, way < 8 ? 1 : 2, WAYS[way][0] * amplitude,
                                           WAYS[way][1] * amplitude, *cost);
            if (found < *cost) {
                *cost = found;
                chosen = way;
            }
        }
        if (chosen < 0) {
            part->tried[i] = pair->n_changes;
            continue;
        }
        for (int64_t k = 0; k < (chosen < 8 ? 1 : 2); k++) {
            part->node[(i + k) % part->n][0] += WAYS[chosen][0] * amplitude;
            part->node[(i + k) % part->n][1] += WAYS[chosen][1] * amplitude;
        }
        *cost = refresh(pair, which);
        pair->n_changes++;
        n_moved++;
    }
    return n_moved;
}

/* New nodes half-way along the longest edges, the first of equals, until there are n. */
static void subdivide(polygon *part, int64_t n)
{
    while (part->n > 0 && part->n < n) {
        int64_t longest = 0;
        double length = -1.0;
        for (int64_t i = 0; i < part->n; i++) {
            const double *a = part->node[i], *b = part->node[(i + 1) % part->n];
            const double square = (b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]);
            if (square > length) {
                length = square;
                longest = i;
            }
        }
        if (length < 4.0)
            return;
        const double *a = part->node[longest], *b = part->node[(longest + 1) % part->n];
        const double middle[2] = {0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])};
        memmove(part->node[longest + 2], part->node[longest + 1],
                (size_t)(part->n - longest - 1) * sizeof part->node[0]);
        memcpy(part->node[longest + 1], middle, sizeof middle);
        part->n++;
    }
}

/* Nodes whose removal lowers the criterion most go, one after the other; returns how many went. */
static int64_t prune(pair *pair, int which, double *cost)
{
    polygon *part = &pair->part[which];
    int64_t n_gone = 0;

    if (part->n == 0)
        return 0;
    find_bound(pair, which);
    *cost = refresh(pair, which);
    for (;;) {
        const polygon whole = *part;
        polygon best;
        int64_t removed = -1;
        for (int64_t i = 0; i < whole.n && whole.n > 3; i++) {
            part->n = whole.n - 1;
            memcpy(part->node, whole.node, (size_t)i * sizeof whole.node[0]);
            memcpy(part->node[i], whole.node[i + 1], (size_t)(whole.n - 1 - i) * sizeof whole.node[0]);
            const double found = refresh(pair, which);
            pair->n_evaluated++;
            if (part->total[COUNT] >= 1.0 && part->total[AREA] >= pair->set->min_area_px && found < *cost &&
                sound(part->node, part->n, (i + part->n - 1) % part->n, 1)) {
                *cost = found;
                best = *part;
                removed = i;
            }
        }
        *part = removed < 0 ? whole : best;
        if (removed < 0)
            return n_gone;
        n_gone++;
    }
}

/* Nodes of a highlight and a shadow, and what is known of them once they have been moved. */
typedef struct {
    int64_t n[2];
    double node[2][MAX_NODES][2];
    double cost, total[2][N_FIELDS];
    int64_t n_accepted, n_evaluated;
} Moved;

/* Moves the pair through all stages of the schedule, if nothing keeps it from being moved: then fault (2) reports what,
 * see below. */
static void move(pair *pair, int64_t n_stages, const double *schedule, Moved *moved, int64_t *fault)
{
    static const int ORDER[2] = {SHADOW, HIGHLIGHT};
    double cost = 0.0;

    pair->n_evaluated = pair->n_accepted = 0;
    for (int which = 0; which < 2; which++) {
        pair->part[which].n = moved->n[which];
        fault[which] = 0;
        memcpy(pair->part[which].node, moved->node[which], (size_t)moved->n[which] * sizeof moved->node[which][0]);
        memset(pair->part[which].total, 0, sizeof pair->part[which].total);
    }
    for (int which = 0; which < 2; which++)
        if (pair->part[which].n > 0) {
            const polygon *part = &pair->part[which];
            find_bound(pair, which);
            measure(pair, which);
            if (!(part->total[COUNT] >= 1.0 && part->total[AREA] >= pair->set->min_area_px))
                fault[which] = 1;
            else if (!sound(part->node, part->n, 0, part->n))
                fault[which] = 2;
        }
    if (fault[HIGHLIGHT] != 0 || fault[SHADOW] != 0)
        return;
    for (int which = 0; which < 2; which++)
        if (pair->part[which].n > 0) {
            find_bound(pair, which);
            cost = refresh(pair, which);
        }
    for (int64_t stage = 0; stage < n_stages; stage++) {
        const double *now = schedule + 3 * stage;
        pair->n_changes++;
        for (int k = 0; k < 2; k++) {
            polygon *part = &pair->part[ORDER[k]];
            if (part->n == 0)
                continue;
            if (now[1] == 0.0) {
                pair->n_accepted += prune(pair, ORDER[k], &cost);
            } else {
                subdivide(part, (int64_t)now[0]);
                find_bound(pair, ORDER[k]);
                cost = refresh(pair, ORDER[k]);
            }
        }
        for (int64_t k = 0; now[1] > 0.0 && k < (int64_t)now[2]; k++) {
            int64_t n_moved = sweep(pair, SHADOW, now[1], &cost);
            n_moved += sweep(pair, HIGHLIGHT, now[1], &cost);
            pair->n_accepted += n_moved;
            if (n_moved == 0)
                break;
        }
    }
    for (int which = 0; which < 2; which++) {
        moved->n[which] = pair->part[which].n;
        memcpy(moved->node[which], pair->part[which].node, (size_t)moved->n[which] * sizeof moved->node[which][0]);
        memcpy(moved->total[which], pair->part[which].total, sizeof moved->total[which]);
    }
    moved->cost = cost;
    moved->n_accepted = pair->n_accepted;
    moved->n_evaluated = pair->n_evaluated;
}

/* highlight, shadow (MAX_NODES, 2), n_nodes (2): nodes and their numbers, in and out. */
static void take_in(Moved *moved, const double *highlight, const double *shadow, const int64_t *n_nodes)
{
    memset(moved, 0, sizeof *moved);
    memcpy(moved->n, n_nodes, sizeof moved->n);
    memcpy(moved->node[HIGHLIGHT], highlight, sizeof moved->node[HIGHLIGHT]);
    memcpy(moved->node[SHADOW], shadow, sizeof moved->node[SHADOW]);
}

static void give_out(const Moved *moved, double *highlight, double *shadow, int64_t *n_nodes, double *out)
{
    memcpy(n_nodes, moved->n, sizeof moved->n);
    memcpy(highlight, moved->node[HIGHLIGHT], sizeof moved->node[HIGHLIGHT]);
    memcpy(shadow, moved->node[SHADOW], sizeof moved->node[SHADOW]);
    out[0] = moved->cost;
    out[1] = (double)moved->n_accepted;
    out[2] = (double)moved->n_evaluated;
    memcpy(out + 3, moved->total, sizeof moved->total);
}

/* Moves the pair through all stages of the schedule.
 *
 * table (n_rows, n_columns + 1, 2): row cumulative sums and counts. set: see `settings`. schedule (n_stages, 3): nodes,
 * amplitude in pixels, sweeps at most; amplitude 0 prunes. highlight, shadow (MAX_NODES, 2): nodes in and out, n_nodes
 * (2): their numbers. bound (n_rows): overwritten. out (3 + 2 * N_FIELDS): criterion, moves, proposals, totals of both.
 * fault (2): what keeps a polygon from being moved, 0 for nothing, 1 too small or not measured, 2 not sound; then
 * nothing else is written.
 */
void auv_mcm_snake(int64_t n_rows, int64_t n_columns, const double *table, const double *set, int64_t n_stages,
                   const double *schedule, double *highlight, double *shadow, int64_t *n_nodes, double *bound,
                   double *out, int64_t *fault)
{
    pair pair = {
        .n_rows = n_rows, .n_columns = n_columns, .table = table, .set = (const settings *)set, .bound = bound};
    Moved moved;

    take_in(&moved, highlight, shadow, n_nodes);
    move(&pair, n_stages, schedule, &moved, fault);
    if (fault[HIGHLIGHT] == 0 && fault[SHADOW] == 0)
        give_out(&moved, highlight, shadow, n_nodes, out);
}

/* Whole pixels from low to high within the window, LEAST_SIDE or more of them. */
static void whole_side(double low, double high, double size, double *from, double *to)
{
    low = rint(fmin(fmax(low, 0.0), size));
    high = rint(fmin(fmax(high, 0.0), size));
    *from = fmax(0.0, fmin(low, size - LEAST_SIDE));
    *to = fmax(high, *from + LEAST_SIDE);
}

/* A strip on the near side of a shadow, `width` pixels wide; returns whether there is room for one in which enough was
 * measured. */
static int strip_before(const pair *pair, double width, const Moved *shadow, Moved *strip)
{
    const double (*const node)[2] = shadow->node[SHADOW];
    const int64_t n = shadow->n[SHADOW], half = n / 2 > 1 ? n / 2 : 1;
    double column[MAX_NODES], top, bottom, nearest, low_row, high_row, low_column, high_column;
    int64_t n_reached = 0, n_measured = 0;

    for (int64_t i = 0; i < n; i++) {
        int64_t k = i;
        for (; k > 0 && column[k - 1] > node[i][1]; k--)
            column[k] = column[k - 1];
        column[k] = node[i][1];
    }
    const double near = floor(half % 2 ? column[half / 2] : (column[half / 2 - 1] + column[half / 2]) / 2.0);
    if (near < LEAST_SIDE)
        return 0;
    extents(node, n, &top, &bottom, &nearest);
    whole_side(top, bottom, (double)pair->n_rows, &low_row, &high_row);
    whole_side(near - width, near, (double)pair->n_columns, &low_column, &high_column);
    const double corner[4][2] = {
        {low_row, low_column}, {low_row, high_column}, {high_row, high_column}, {high_row, low_column}};
    strip->n[HIGHLIGHT] = 4;
    memcpy(strip->node[HIGHLIGHT], corner, sizeof corner);
    for (int64_t row = (int64_t)low_row; row < (int64_t)high_row && row < pair->n_rows; row++) {
        const double *cell = pair->table + 2 * row * (pair->n_columns + 1);
        const int64_t far = high_column < (double)pair->n_columns ? (int64_t)high_column : pair->n_columns;
        n_reached++;
        n_measured += cell[2 * far + 1] - cell[2 * (int64_t)low_column + 1] >= 1.0;
    }
    const int64_t enough = n_reached < LEAST_ROWS ? n_reached : LEAST_ROWS;
    return n_measured >= (enough > 1 ? enough : 1);
}

/* The best pair from a start, as snake_descent.py has it. schedule (n_stages[0] + n_stages[1] + n_stages[2], 3):
 * coarse, fine, polish. strip_px: width of the strip before a shadow. moves (1): out, those on the way to the pair. The
 * rest as above.
 */
void auv_mcm_snake_descend(int64_t n_rows, int64_t n_columns, const double *table, const double *set,
                           const int64_t *n_stages, const double *schedule, double strip_px, double *highlight,
                           double *shadow, int64_t *n_nodes, double *bound, double *out, int64_t *fault, int64_t *moves)
{
    pair pair = {
        .n_rows = n_rows, .n_columns = n_columns, .table = table, .set = (const settings *)set, .bound = bound};
    const double *fine = schedule + 3 * n_stages[0], *polish = fine + 3 * n_stages[1];
    Moved best, start;

    take_in(&best, highlight, shadow, n_nodes);
    start = best;
    move(&pair, n_stages[0], schedule, &best, fault);
    if (fault[HIGHLIGHT] != 0 || fault[SHADOW] != 0)
        return;
    *moves = best.n_accepted;
    if (start.n[SHADOW] > 0) {
        Moved alone = start, other;
        alone.n[HIGHLIGHT] = 0;
        move(&pair, n_stages[0], schedule, &alone, fault);
        other = alone;
        if (fault[SHADOW] == 0 && strip_before(&pair, strip_px, &alone, &other)) {
            const int64_t last = n_stages[0] > 0 ? 1 : 0;
            move(&pair, last, fine - 3 * last, &other, fault);
            if (fault[HIGHLIGHT] != 0 || fault[SHADOW] != 0)
                return;
            if (other.cost < best.cost) {
                best = other;
                *moves = alone.n_accepted + other.n_accepted;
            }
        }
    }
    move(&pair, n_stages[1], fine, &best, fault);
    *moves += best.n_accepted;
    if (best.n[HIGHLIGHT] > 0 && best.n[SHADOW] > 0) {
        const Moved both = best;
        for (int which = SHADOW; which >= HIGHLIGHT; which--) {
            Moved lone = both;
            lone.n[1 - which] = 0;
            move(&pair, which == SHADOW ? n_stages[2] : 0, polish, &lone, fault);
            if (lone.cost < best.cost) {
                best = lone;
                *moves += lone.n_accepted;
            }
        }
    }
    give_out(&best, highlight, shadow, n_nodes, out);
}

/* The columns at which a polygon's edges that run up, and those that run down, cross each row; the last one counts.
 *
 * node (n, 2). sides (2, n_rows): -1 where there is none.
 */
void auv_mcm_snake_sides(int64_t n_rows, int64_t n_columns, int64_t n, const double *node, int64_t *sides)
{
    const pair window = {.n_rows = n_rows, .n_columns = n_columns};

    for (int64_t i = 0; i < 2 * n_rows; i++)
        sides[i] = -1;
    for (int64_t i = 0; i < n; i++) {
        const double *a = node + 2 * i, *b = node + 2 * ((i + 1) % n);
        const crossing edge = crossed(&window, a, b);
        int64_t *side = sides + (b[0] > a[0] ? n_rows : 0);
        for (int64_t row = edge.start; row < edge.stop; row++)
            side[row] = column_at(&edge, row, n_columns);
    }
}

/* N (m - 1 - ln m) for `count` pixels of mean m over the window's; 0 on the wrong side of 1. */
static double evidence(int64_t which, double total, double count)
{
    if (count < 1.0)
        return 0.0;
    const double mean = total / count > 1e-6 ? total / count : 1e-6;
    return (which == HIGHLIGHT ? mean > 1.0 : mean < 1.0) ? count * (mean - 1.0 - log(mean)) : 0.0;
}

/* Puts the element that would be at `place` in order there, none after it being smaller (C. A. R. Hoare's Find). */
static void select_place(double *value, int64_t n, int64_t place)
{
    int64_t first = 0, last = n - 1;
    while (first < last) {
        const double pivot = value[first + (last - first) / 2];
        int64_t low = first, high = last;
        while (low <= high) {
            while (value[low] < pivot)
                low++;
            while (value[high] > pivot)
                high--;
            if (low <= high) {
                const double held = value[low];
                value[low++] = value[high];
                value[high--] = held;
            }
        }
        if (place <= high)
            last = high;
        else if (place >= low)
            first = low;
        else
            return;
    }
}

/* Evidence of polygons shifted clear of themselves over that in place, see snake_elsewhere.py: the best, and what one
 * in twenty exceeds.
 *
 * which, n_nodes (n_polygons); node (sum of n_nodes, 2). step (2): rows and columns between shifts. sides (2, n_rows),
 * offset (n_room), sums (n_room, 2), there (n_room): overwritten; n_room: no fewer than there are shifts. out (2).
 */
void auv_mcm_snake_elsewhere(int64_t n_rows, int64_t n_columns, const double *restrict table, int64_t n_polygons,
                             const int64_t *restrict which, const int64_t *restrict n_nodes,
                             const double *restrict node, const int64_t *restrict step, int64_t *restrict sides,
                             int64_t *restrict offset, double *restrict sums, double *restrict there,
                             double *restrict out)
{
    int64_t n_all = 0, n = 0;
    double top = INFINITY, bottom = -INFINITY, near = INFINITY, far = -INFINITY, here = 0.0;

    for (int64_t i = 0; i < n_polygons; i++)
        n_all += n_nodes[i];
    for (int64_t i = 0; i < n_all; i++) {
        top = fmin(top, node[2 * i]);
        bottom = fmax(bottom, node[2 * i]);
        near = fmin(near, node[2 * i + 1]);
        far = fmax(far, node[2 * i + 1]);
    }
    const int64_t first_row = (int64_t)floor(top), last_row = (int64_t)ceil(bottom);
    const int64_t first_column = (int64_t)floor(near), last_column = (int64_t)ceil(far);
    for (int64_t row = -first_row; row <= n_rows - last_row; row += step[0])
        for (int64_t column = -first_column; column <= n_columns - last_column; column += step[1])
            if (llabs(row) >= last_row - first_row || llabs(column) >= last_column - first_column)
                offset[n++] = 2 * (row * (n_columns + 1) + column);
    for (int64_t k = 0; k < n; k++)
        there[k] = 0.0;
    for (int64_t i = 0; i < n_polygons; i++) {
        double total = 0.0, count = 0.0;
        if (n_nodes[i] == 0)
            continue;
        auv_mcm_snake_sides(n_rows, n_columns, n_nodes[i], node, sides);
        node += 2 * n_nodes[i];
        for (int64_t k = 0; k < 2 * n; k++)
            sums[k] = 0.0;
        for (int64_t row = 0; row < n_rows; row++) {
            if (sides[row] < 0 || sides[n_rows + row] <= sides[row])
                continue;
            const double *low = table + 2 * (row * (n_columns + 1) + sides[row]);
            const double *high = table + 2 * (row * (n_columns + 1) + sides[n_rows + row]);
            total += high[0] - low[0];
            count += high[1] - low[1];
            for (int64_t k = 0; k < n; k++) {
                sums[2 * k] += high[offset[k]] - low[offset[k]];
                sums[2 * k + 1] += high[offset[k] + 1] - low[offset[k] + 1];
            }
        }
        here += evidence(which[i], total, count);
        for (int64_t k = 0; k < n; k++)
            there[k] += evidence(which[i], sums[2 * k], sums[2 * k + 1]);
    }
    out[0] = out[1] = here > 0.0 ? 0.0 : INFINITY;
    if (here <= 0.0 || n == 0)
        return;
    const double place = 0.95 * (double)(n - 1), part = place - floor(place);
    const int64_t before = (int64_t)place;
    double best = there[0];
    for (int64_t k = 1; k < n; k++)
        best = there[k] > best ? there[k] : best;
    select_place(there, n, before);
    double after = there[before];
    for (int64_t k = before + 1; k < n; k++)
        after = k == before + 1 || there[k] < after ? there[k] : after;
    /* As numpy's quantile rounds. */
    const double common = part < 0.5 ? there[before] + (after - there[before]) * part
                                     : after - (after - there[before]) * (1.0 - part);
    out[0] = best / here;
    out[1] = common / here;
}
