/* What the files of the snake share: see snake.py for the definitions.
 *
 * Sums, counts and node coordinates are dyadic fractions that doubles hold exactly, so totals may be updated by
 * differences without drift and every decision equals the twin's. Logarithms come from the C library that Python's own
 * math.log calls.
 */

#ifndef AUV_MCM_SNAKE_H
#define AUV_MCM_SNAKE_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "wide.h"

#define MAX_NODES 64
#define N_FIELDS 8
#define HIGHLIGHT 0
#define SHADOW 1
#define BACKGROUND 2

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

/* Nodes of a highlight and a shadow, and what is known of them once they have been moved. */
typedef struct {
    int64_t n[2];
    double node[2][MAX_NODES][2];
    double cost, total[2][N_FIELDS];
    int64_t n_accepted, n_evaluated;
} Moved;

/* Of snake.c. */
INTERNAL void snake_extents(const double (*node)[2], int64_t n, double *top, double *bottom, double *near);
INTERNAL void snake_move(pair *pair, int64_t n_stages, const double *schedule, Moved *moved, int64_t *fault);
INTERNAL void snake_take_in(Moved *moved, const double *highlight, const double *shadow, const int64_t *n_nodes);
INTERNAL void snake_give_out(const Moved *moved, double *highlight, double *shadow, int64_t *n_nodes, double *out);

/* Of snake_sound.c. */
INTERNAL int snake_sound(const double (*node)[2], int64_t n, int64_t first, int64_t n_edges);

#endif
