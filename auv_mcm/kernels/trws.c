/* Minimisers of a Potts energy of three labels on a grid of eight neighbours, see trws.py for their definition.
 *
 * Cells run in raster order. Edges are kept at the earlier of their two cells, in the order right, down-left, down,
 * down-right. One message per edge serves both passes: what a pass reads is what the pass before wrote.
 */

#include <math.h>
#include <stdint.h>

#define LABELS 3
#define EDGES 4

typedef struct {
    double to[LABELS][EDGES];
} Messages;

static inline double smallest(double a, double b, double c)
{
    const double ab = a < b ? a : b;
    return ab < c ? ab : c;
}

/* The share of a cell's costs that each monotonic chain through it carries: one over the number of those chains. */
static inline double share(int64_t row, int64_t column, int64_t n_rows, int64_t n_columns)
{
    const int64_t left = column > 0, right = column + 1 < n_columns;
    const int64_t later = right + (row + 1 < n_rows ? left + 1 + right : 0);
    const int64_t earlier = left + (row > 0 ? left + 1 + right : 0);
    const int64_t chains = later > earlier ? later : earlier;
    return 1.0 / (double)(chains > 0 ? chains : 1);
}

/* Weights of a cell's four later edges; zero where the grid ends, which makes their messages zero. */
static inline void later_weights(int64_t row, int64_t column, int64_t n_rows, int64_t n_columns, const double *weight,
                                 double *own)
{
    const int down = row + 1 < n_rows;
    own[0] = column + 1 < n_columns ? weight[0] : 0.0;
    own[1] = down && column > 0 ? weight[1] : 0.0;
    own[2] = down ? weight[2] : 0.0;
    own[3] = down && column + 1 < n_columns ? weight[3] : 0.0;
}

static inline void earlier_weights(int64_t row, int64_t column, int64_t n_columns, const double *weight, double *own)
{
    const int up = row > 0;
    own[0] = column > 0 ? weight[0] : 0.0;
    own[1] = up && column + 1 < n_columns ? weight[1] : 0.0;
    own[2] = up ? weight[2] : 0.0;
    own[3] = up && column > 0 ? weight[3] : 0.0;
}

/* The message from the left is added last: it is the one still being computed. */
static inline void gather(const double *unary, const Messages *cell, int64_t stride, double *cost)
{
    for (int k = 0; k < LABELS; k++) {
        const double later = (cell->to[k][0] + cell->to[k][1]) + (cell->to[k][2] + cell->to[k][3]);
        const double above = (cell[1 - stride].to[k][1] + cell[-stride].to[k][2]) + cell[-1 - stride].to[k][3];
        cost[k] = ((unary[k] + later) + above) + cell[-1].to[k][0];
    }
}

static inline void forward_cell(const double *unary, Messages *cell, int64_t stride, double gamma, const double *weight)
{
    double cost[LABELS];
    gather(unary, cell, stride, cost);
    for (int e = 0; e < EDGES; e++) {
        const double a = gamma * cost[0] - cell->to[0][e];
        const double b = gamma * cost[1] - cell->to[1][e];
        const double c = gamma * cost[2] - cell->to[2][e];
        const double least = smallest(a, b, c);
        cell->to[0][e] = a - least < weight[e] ? a - least : weight[e];
        cell->to[1][e] = b - least < weight[e] ? b - least : weight[e];
        cell->to[2][e] = c - least < weight[e] ? c - least : weight[e];
    }
}

/* Returns what the cell and its earlier edges add to the lower bound. */
static inline double backward_cell(const double *unary, Messages *cell, int64_t stride, double gamma,
                                   const double *weight)
{
    const int64_t other[EDGES] = {-1, 1 - stride, -stride, -1 - stride};
    double cost[LABELS], bound[EDGES];
    gather(unary, cell, stride, cost);
    const double floor_cost = smallest(cost[0], cost[1], cost[2]);
    for (int e = 0; e < EDGES; e++) {
        Messages *from = cell + other[e];
        const double a = gamma * cost[0] - from->to[0][e];
        const double b = gamma * cost[1] - from->to[1][e];
        const double c = gamma * cost[2] - from->to[2][e];
        const double least = smallest(a, b, c);
        from->to[0][e] = a - least < weight[e] ? a - least : weight[e];
        from->to[1][e] = b - least < weight[e] ? b - least : weight[e];
        from->to[2][e] = c - least < weight[e] ? c - least : weight[e];
        bound[e] = least - gamma * floor_cost;
    }
    return floor_cost + ((bound[0] + bound[1]) + (bound[2] + bound[3]));
}

/* Cost of each label against the labels of the earlier neighbours. */
static inline void against_earlier(const uint8_t *label, int64_t n_columns, const double *weight, double *cost)
{
    const int64_t other[EDGES] = {-1, 1 - n_columns, -n_columns, -1 - n_columns};
    for (int k = 0; k < LABELS; k++)
        cost[k] = 0.0;
    for (int e = 0; e < EDGES; e++) {
        if (weight[e] != 0.0) {
            const int neighbour = label[other[e]];
            for (int k = 0; k < LABELS; k++)
                cost[k] += k != neighbour ? weight[e] : 0.0;
        }
    }
}

static inline void against_later(const uint8_t *label, int64_t n_columns, const double *weight, double *cost)
{
    const int64_t other[EDGES] = {1, n_columns - 1, n_columns, n_columns + 1};
    for (int e = 0; e < EDGES; e++) {
        if (weight[e] != 0.0) {
            const int neighbour = label[other[e]];
            for (int k = 0; k < LABELS; k++)
                cost[k] += k != neighbour ? weight[e] : 0.0;
        }
    }
}

static inline uint8_t cheapest(const double *cost)
{
    const int first = cost[1] < cost[0] ? 1 : 0;
    return (uint8_t)(cost[2] < cost[first] ? 2 : first);
}

/* Labels in raster order, each against the earlier labels and the messages of the later cells; returns their energy. */
static double decode(int64_t n_rows, int64_t n_columns, const double *unary, const double *weight,
                     const Messages *messages, uint8_t *label)
{
    const int64_t stride = n_columns + 2;
    double energy = 0.0;
    for (int64_t row = 0; row < n_rows; row++) {
        for (int64_t column = 0; column < n_columns; column++) {
            const int64_t at = row * n_columns + column;
            const Messages *cell = messages + (row + 1) * stride + column + 1;
            double own[EDGES], pair[LABELS], cost[LABELS];
            earlier_weights(row, column, n_columns, weight, own);
            against_earlier(label + at, n_columns, own, pair);
            for (int k = 0; k < LABELS; k++)
                cost[k] = (unary[LABELS * at + k] + pair[k]) +
                          ((cell->to[k][0] + cell->to[k][1]) + (cell->to[k][2] + cell->to[k][3]));
            label[at] = cheapest(cost);
            energy += unary[LABELS * at + label[at]] + pair[label[at]];
        }
    }
    return energy;
}

/* unary (n_rows, n_columns, 3); weight (4). messages (n_rows + 1, n_columns + 2, 3, 4): in, any, zero in cells outside
 * the grid; out, those of the last sweep. label, scratch (n_rows, n_columns): out, the best labels met; overwritten.
 * trace (n_sweeps, 2): out, lower bound and energy after each sweep. done (1): out, the sweeps made. Stops early once
 * the best energy is within tolerance of the bound.
 */
void auv_mcm_trws(int64_t n_rows, int64_t n_columns, int64_t n_sweeps, double tolerance, const double *restrict unary,
                  const double *restrict weight, void *restrict message, uint8_t *restrict label,
                  uint8_t *restrict scratch, double *restrict trace, int64_t *restrict done)
{
    Messages *messages = message;
    const int64_t stride = n_columns + 2;
    double best = INFINITY;
    *done = 0;
    for (int64_t sweep = 0; sweep < n_sweeps; sweep++) {
        double bound = 0.0;
        for (int64_t row = 0; row < n_rows; row++) {
            double own[EDGES] = {0.0}, gamma = 1.0;
            for (int64_t column = 0; column < n_columns; column++) {
                if (column < 2 || column + 1 == n_columns) {
                    later_weights(row, column, n_rows, n_columns, weight, own);
                    gamma = share(row, column, n_rows, n_columns);
                }
                forward_cell(unary + LABELS * (row * n_columns + column), messages + (row + 1) * stride + column + 1,
                             stride, gamma, own);
            }
        }
        for (int64_t row = n_rows - 1; row >= 0; row--) {
            double own[EDGES] = {0.0}, gamma = 1.0;
            for (int64_t column = n_columns - 1; column >= 0; column--) {
                if (column + 2 >= n_columns || column == 0) {
                    earlier_weights(row, column, n_columns, weight, own);
                    gamma = share(row, column, n_rows, n_columns);
                }
                bound += backward_cell(unary + LABELS * (row * n_columns + column),
                                       messages + (row + 1) * stride + column + 1, stride, gamma, own);
            }
        }
        const double energy = decode(n_rows, n_columns, unary, weight, messages, scratch);
        trace[2 * sweep] = bound;
        trace[2 * sweep + 1] = energy;
        if (energy < best) {
            best = energy;
            for (int64_t at = 0; at < n_rows * n_columns; at++)
                label[at] = scratch[at];
        }
        *done = sweep + 1;
        if (best - bound <= tolerance)
            break;
    }
}

/* label (n_rows, n_columns): in, the start; out, the labels no single change of which lowers the energy, or those after
 * n_sweeps. done (1): out, the sweeps made, the one that changed nothing included.
 */
void auv_mcm_icm(int64_t n_rows, int64_t n_columns, int64_t n_sweeps, const double *restrict unary,
                 const double *restrict weight, uint8_t *restrict label, int64_t *restrict done)
{
    *done = 0;
    for (int64_t sweep = 0; sweep < n_sweeps; sweep++) {
        int64_t changed = 0;
        for (int64_t row = 0; row < n_rows; row++) {
            for (int64_t column = 0; column < n_columns; column++) {
                const int64_t at = row * n_columns + column;
                double before[EDGES], after[EDGES], cost[LABELS];
                earlier_weights(row, column, n_columns, weight, before);
                later_weights(row, column, n_rows, n_columns, weight, after);
                against_earlier(label + at, n_columns, before, cost);
                against_later(label + at, n_columns, after, cost);
                for (int k = 0; k < LABELS; k++)
                    cost[k] += unary[LABELS * at + k];
                const uint8_t best = cheapest(cost);
                if (cost[best] < cost[label[at]]) {
                    label[at] = best;
                    changed++;
                }
            }
        }
        *done = sweep + 1;
        if (changed == 0)
            break;
    }
}
