/* What crosses rows, and the evidence of polygons that are shifted, see snake_elsewhere.py. */

#include "snake.h"

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
