/* A highlight and a shadow polygon moved together over row cumulative sums, see snake.py and its twin snake_twin.py. */

#include "snake.h"

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

void snake_extents(const double (*node)[2], int64_t n, double *top, double *bottom, double *near)
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
    snake_extents(part->node, part->n, &part->top, &part->bottom, &part->near);
}

static double refresh(pair *pair, int which)
{
    const polygon *part = &pair->part[which];
    measure(pair, which);
    const shape whole = {part->total, part->own, part->top, part->bottom, part->near};
    return criterion(pair, which, &whole);
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
        snake_extents(part->node, n, &moved.top, &moved.bottom, &moved.near);
        const double cost = criterion(pair, which, &moved);
        if (cost < best && snake_sound(part->node, n, before, n_moved + 1))
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
                snake_sound(part->node, part->n, (i + part->n - 1) % part->n, 1)) {
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

/* Moves the pair through all stages of the schedule, if nothing keeps it from being moved: then fault (2) reports what,
 * see below. */
void snake_move(pair *pair, int64_t n_stages, const double *schedule, Moved *moved, int64_t *fault)
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
            else if (!snake_sound(part->node, part->n, 0, part->n))
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
void snake_take_in(Moved *moved, const double *highlight, const double *shadow, const int64_t *n_nodes)
{
    memset(moved, 0, sizeof *moved);
    memcpy(moved->n, n_nodes, sizeof moved->n);
    memcpy(moved->node[HIGHLIGHT], highlight, sizeof moved->node[HIGHLIGHT]);
    memcpy(moved->node[SHADOW], shadow, sizeof moved->node[SHADOW]);
}

void snake_give_out(const Moved *moved, double *highlight, double *shadow, int64_t *n_nodes, double *out)
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

    snake_take_in(&moved, highlight, shadow, n_nodes);
    snake_move(&pair, n_stages, schedule, &moved, fault);
    if (fault[HIGHLIGHT] == 0 && fault[SHADOW] == 0)
        snake_give_out(&moved, highlight, shadow, n_nodes, out);
}
