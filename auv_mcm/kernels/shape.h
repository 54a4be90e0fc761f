/* What the files of solids as explanations of an image share, see shape.py for their definition. */

#ifndef AUV_MCM_SHAPE_H
#define AUV_MCM_SHAPE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { SPHERE, CYLINDER, CONE, WEDGE };
enum { FIELDS = 8, EDGES = 9, CORNERS = 6, N_ENDS = 3, MAX_TAPS = 3, MIXTURES = 27 }; /* 3 to the power of MAX_TAPS */
enum { BLOCK = 96 };                                                                  /* slices */

#define FORBIDDEN 1e12

/* What of a solid does not change from slice to slice. */
typedef struct {
    double reach, top; /* horizontal radius within which all of it lies; height over the floor */
    double sine, cosine, per_sine, per_cosine;
    double base_radius, rim_radius, height, taper, per_taper;
    double corner[CORNERS][3], across_per_m[EDGES], up_per_m[EDGES]; /* slopes of edges per metre along the track */
} Placed;

/* A block of slices: where they are, along the track from the object and across it to its place; what they hold;
 * columns, see shape_cut(). */
typedef struct {
    int64_t n;
    double u[BLOCK], y[BLOCK];
    double front_squared[BLOCK], tangent[BLOCK], height[BLOCK], foot[BLOCK];
    double end[N_ENDS][BLOCK];
    int64_t hit[BLOCK]; /* whether the slice meets the solid; nothing else is known of one that does not */
} Slices;

typedef struct {
    int64_t n_rows, n_columns;
    double row_m, column_m, first_m, altitude, weight, smear, shear;
    const double *echoes, *counts;
    double total, n_total;
    int is_whole; /* every pixel counts */
} Image;

typedef struct {
    int n_taps;
    int64_t n_steps; /* of Fisher scoring */
    const double *angle;
    double share[MIXTURES][2]; /* of highlight and shadow, by mixture: its digit of base 3 per tap is 0 floor, 1
                                  highlight, 2 shadow */
} Beam;

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double clamp(double value, double low, double high) { return smaller(larger(value, low), high); }

/* Of shape_slices.c. */
INTERNAL void shape_place(int64_t kind, const double *solid, Placed *placed);
INTERNAL void shape_cut(int64_t kind, const double *solid, const Placed *placed, const Image *image, double altitude,
                        Slices *slices);

/* Of shape.c. */
INTERNAL double shape_cost_of(int64_t kind, const double *hypothesis, const Image *image, const Beam *beam,
                              double *mean);
INTERNAL Beam shape_beam_of(int64_t n_taps, const double *angle, const double *share, int64_t n_steps);
INTERNAL Image shape_image_of(int64_t n_rows, int64_t n_columns, const double *scalars, const double *echoes,
                              const double *counts);

#endif
