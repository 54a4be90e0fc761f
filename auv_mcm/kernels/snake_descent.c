/* The best pair from a start, see snake_descent.py. */

#include "snake.h"

#define LEAST_SIDE 4.0 /* pixels, of a box */
#define LEAST_ROWS 3   /* in which pixels must have been measured */

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
    snake_extents(node, n, &top, &bottom, &nearest);
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

    snake_take_in(&best, highlight, shadow, n_nodes);
    start = best;
    snake_move(&pair, n_stages[0], schedule, &best, fault);
    if (fault[HIGHLIGHT] != 0 || fault[SHADOW] != 0)
        return;
    *moves = best.n_accepted;
    if (start.n[SHADOW] > 0) {
        Moved alone = start, other;
        alone.n[HIGHLIGHT] = 0;
        snake_move(&pair, n_stages[0], schedule, &alone, fault);
        other = alone;
        if (fault[SHADOW] == 0 && strip_before(&pair, strip_px, &alone, &other)) {
            const int64_t last = n_stages[0] > 0 ? 1 : 0;
            snake_move(&pair, last, fine - 3 * last, &other, fault);
            if (fault[HIGHLIGHT] != 0 || fault[SHADOW] != 0)
                return;
            if (other.cost < best.cost) {
                best = other;
                *moves = alone.n_accepted + other.n_accepted;
            }
        }
    }
    snake_move(&pair, n_stages[1], fine, &best, fault);
    *moves += best.n_accepted;
    if (best.n[HIGHLIGHT] > 0 && best.n[SHADOW] > 0) {
        const Moved both = best;
        for (int which = SHADOW; which >= HIGHLIGHT; which--) {
            Moved lone = both;
            lone.n[1 - which] = 0;
            snake_move(&pair, which == SHADOW ? n_stages[2] : 0, polish, &lone, fault);
            if (lone.cost < best.cost) {
                best = lone;
                *moves += lone.n_accepted;
            }
        }
    }
    snake_give_out(&best, highlight, shadow, n_nodes, out);
}
