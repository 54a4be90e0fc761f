/* Costs of solids as explanations of an image, see shape.py for their definition.
 *
 * Slices are those of auv_mcm.solids.slices and polyhedron, a block of them at a time so that the compiler can use
 * vectors. Newton's methods start from simpler bounds and go on until they stand still; as they close in from one side,
 * that finds the same point.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "wide.h"

enum { SPHERE, CYLINDER, CONE, WEDGE };
enum {
    FIELDS = 8,
    EDGES = 9,
    CORNERS = 6,
    MAX_STEPS = 60,
    N_ENDS = 3,
    MAX_TAPS = 3,
    MIXTURES = 27,
    BLOCK = 96,
    VECTOR = 4
}; /* 3 to the power of MAX_TAPS; slices; those that wide vectors hold */
enum { SUNK = 7, RATIO = 8, N_FACTORS = 9 };

#define FORBIDDEN 1e12
#define LEAST_MEAN 1e-6
#define LEVEL 1e-15
#define STILL 1e-7 /* a step of Newton's method of this size, relative, leaves an error of its square */

/* What of a solid does not change from slice to slice. */
typedef struct {
    double reach, top; /* horizontal radius within which all of it lies; height over the floor */
    double sine, cosine, per_sine, per_cosine;
    double base_radius, rim_radius, height, taper, per_taper;
    double corner[CORNERS][3], across_per_m[EDGES], up_per_m[EDGES]; /* slopes of edges per metre along the track */
} Placed;

typedef struct {
    double front_squared, tangent, height,
        foot; /* slant range; ground range and height; ground range of a vertical face, if any is seen */
} Slice;

/* A block of slices: where they are, along the track from the object and across it to its place; what they hold;
 * columns, see cut(). */
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

static const int EDGE[EDGES][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {1, 4}, {2, 5}, {4, 5}, {0, 4}, {3, 5}};

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double clamp(double value, double low, double high) { return smaller(larger(value, low), high); }

static inline double half_chord(double radius, double lateral)
{
    return sqrt(larger((radius - lateral) * (radius + lateral), 0.0));
}

/* per_slope: 1 / |slope|, unused where that is no number. */
static inline void interval(double offset, double slope, double per_slope, double half_width, double *low, double *high)
{
    if (fabs(slope) < LEVEL) {
        *high = fabs(offset) <= half_width ? INFINITY : -INFINITY;
        *low = -*high;
        return;
    }
    const double way = slope < 0.0 ? -offset : offset;
    *low = (-half_width - way) * per_slope;
    *high = (half_width - way) * per_slope;
}

static inline double below(double altitude, double centre, double half)
{
    return altitude - clamp(altitude, larger(centre - half, 0.0), larger(centre + half, 0.0));
}

/* Where the nearest point of a cylinder's circle, drawn out across the track, is: Newton's method in all slices at
 * once. */
WIDE static void arch_fronts(double radius, double cosine, double rise, double sine, Slices *slices, double *front)
{
    const double per_radius = 1.0 / radius, second = rise * per_radius, squeeze = cosine * cosine;
    double t[BLOCK], first[BLOCK];
    int64_t moving[BLOCK];

    for (int64_t i = 0; i < slices->n; i++) {
        const double sonar = -slices->u[i] * sine - cosine * slices->y[i];
        first[i] = sonar * per_radius;
        const double square = first[i] * first[i] + second * second;
        t[i] = larger(sqrt(square) - 1.0, squeeze > 1e-30 ? (fabs(first[i]) - 1.0) / squeeze : 0.0);
        moving[i] = slices->hit[i] & (square <= 1.0 ? 0 : 1);
    }
    for (int step = 0; step < MAX_STEPS; step++) {
        int64_t any = 0;
        for (int64_t i = 0; i < slices->n; i++) {
            const double wide = 1.0 / (squeeze * t[i] + 1.0), high = 1.0 / (t[i] + 1.0);
            const double a = first[i] * wide, b = second * high, value = a * a + b * b;
            const double move = value * (value - 1.0) / ((sqrt(value) + 1.0) * (a * a * squeeze * wide + b * b * high));
            const double next = larger(t[i] + move, 0.0);
            t[i] = moving[i] ? next : t[i];
            moving[i] = fabs(move) <= STILL * (1.0 + next) ? 0 : moving[i];
            any |= moving[i];
        }
        if (!any)
            break;
    }
    for (int64_t i = 0; i < slices->n; i++) {
        const double square = first[i] * first[i] + second * second, lateral = -slices->u[i] * sine;
        const double found = -(slices->y[i] + lateral * cosine * t[i]) / (squeeze * t[i] + 1.0);
        front[i] = square <= 1.0 ? -INFINITY : found;
    }
}

WIDE static void cylinders(const double *solid, const Placed *placed, double altitude, Slices *slices)
{
    const double radius = solid[0], centre = radius - solid[3], sunk = smaller(centre, 0.0), cosine = placed->cosine;
    const double rise = altitude - centre;
    const int64_t is_there = radius > 0.0 && !(radius <= -sunk);
    double low[BLOCK], high[BLOCK], front[BLOCK];

    for (int64_t i = 0; i < slices->n; i++) {
        double end_low, end_high, side_low, side_high;
        interval(slices->u[i] * cosine, placed->sine, placed->per_sine, 0.5 * solid[1], &end_low, &end_high);
        interval(-slices->u[i] * placed->sine, cosine, placed->per_cosine, half_chord(radius, sunk), &side_low,
                 &side_high);
        low[i] = larger(side_low, end_low);
        high[i] = smaller(side_high, end_high);
        slices->hit[i] = low[i] <= high[i] ? is_there : 0;
    }
    arch_fronts(radius, cosine, rise, placed->sine, slices, front);
    for (int64_t i = 0; i < slices->n; i++) {
        const double y = slices->y[i], lateral = -slices->u[i] * placed->sine, sonar = lateral - cosine * y;
        const double square = sonar * sonar + rise * rise, power = square - radius * radius;
        const double touch = radius * (radius * sonar + sqrt(larger(power, 0.0)) * rise) / square;
        const double across = clamp(power > 0.0 ? (touch - lateral) / larger(cosine, LEVEL) : -INFINITY, low[i],
                                    high[i]);
        const double nearest = clamp(front[i], low[i], high[i]);
        const double down = below(altitude, centre, half_chord(radius, lateral + cosine * nearest));

        slices->front_squared[i] = (y + nearest) * (y + nearest) + down * down;
        slices->tangent[i] = y + across;
        slices->height[i] = larger(centre + half_chord(radius, lateral + cosine * across), 0.0);
        slices->foot[i] = 0.0;
    }
}

/* A cylinder's slices without ends and turn: circles, whose nearest points need no search. */
WIDE static void spheres(const double *solid, double altitude, Slices *slices)
{
    const double whole = solid[0], centre = whole - solid[1], sunk = smaller(centre, 0.0), rise = altitude - centre;

    for (int64_t i = 0; i < slices->n; i++) {
        const double y = slices->y[i], radius = half_chord(whole, slices->u[i]);
        const double at_floor = half_chord(radius, sunk), square = y * y + rise * rise;
        const double power = square - radius * radius, per_square = 1.0 / square;
        const double touch = radius * (sqrt(larger(power, 0.0)) * rise - radius * y) * per_square;
        const double across = clamp(power > 0.0 ? touch : -INFINITY, -at_floor, at_floor);
        const double front = clamp(power > 0.0 ? -radius * y * sqrt(per_square) : -INFINITY, -at_floor, at_floor);
        const double down = below(altitude, centre, half_chord(radius, front));
        const int64_t within = fabs(slices->u[i]) < whole ? 1 : 0, above = radius <= -sunk ? 0 : 1;

        slices->hit[i] = within & above;
        slices->front_squared[i] = (y + front) * (y + front) + down * down;
        slices->tangent[i] = y + across;
        slices->height[i] = larger(centre + half_chord(radius, across), 0.0);
        slices->foot[i] = 0.0;
    }
}

static inline double cone_side(const Placed *placed, double across, double u, double base, double rim, int64_t flat)
{
    const double slope = clamp((placed->base_radius - sqrt(across * across + u * u)) * placed->per_taper, 0.0,
                               placed->height);
    const double side = fabs(across) >= base ? 0.0 : slope;
    return flat & (fabs(across) <= rim ? 1 : 0) ? placed->height : side;
}

/* How far before the axis the sloping side is nearest. */
WIDE static void cone_fronts(double base_radius, double k, double altitude, const Slices *slices, double *front)
{
    const double m = base_radius - k * altitude, target = 1.0 + k * k, thin = 1e-12 * base_radius;
    double x[BLOCK];
    int64_t moving[BLOCK];

    for (int64_t i = 0; i < slices->n; i++) {
        const double u = larger(fabs(slices->u[i]), thin), slope = k * k * larger(slices->y[i], 1e-6);
        const double at_corner = slope + m, saturated = (target - m / u) / slope;
        const double through_origin = at_corner > 0.0 ? target / at_corner : INFINITY;
        const double low = smaller(through_origin, saturated), high = larger(through_origin, saturated);
        x[i] = m < 0.0 ? low : high;
        moving[i] = slices->hit[i];
    }
    for (int step = 0; step < MAX_STEPS; step++) {
        int64_t any = 0;
        for (int64_t i = 0; i < slices->n; i++) {
            const double u = larger(fabs(slices->u[i]), thin), slope = k * k * larger(slices->y[i], 1e-6);
            const double shrink = 1.0 / sqrt(1.0 + u * u * x[i] * x[i]);
            const double move = (slope * x[i] + m * x[i] * shrink - target) / (slope + m * shrink * shrink * shrink);
            const double next = x[i] - move;
            x[i] = moving[i] ? next : x[i];
            moving[i] = fabs(move) <= STILL * fabs(next) ? 0 : moving[i];
            any |= moving[i];
        }
        if (!any)
            break;
    }
    for (int64_t i = 0; i < slices->n; i++)
        front[i] = 1.0 / x[i];
}

WIDE static void cones(const Placed *placed, double altitude, Slices *slices)
{
    const double base_radius = placed->base_radius, apex = base_radius - placed->taper * altitude;
    const int64_t is_there = placed->height > 0.0;
    double fronts[BLOCK];

    for (int64_t i = 0; i < slices->n; i++)
        slices->hit[i] = fabs(slices->u[i]) <= base_radius ? is_there : 0;
    cone_fronts(base_radius, larger(placed->taper, 1e-9), altitude, slices, fronts);
    for (int64_t i = 0; i < slices->n; i++) {
        const double y = slices->y[i], u = fabs(slices->u[i]);
        const double base = half_chord(base_radius, u), rim = half_chord(placed->rim_radius, u);
        const int64_t flat = u <= placed->rim_radius ? 1 : 0;
        const double per_far = 1.0 / larger(sqrt(u * u + y * y), 1e-300), sine = clamp(apex * per_far, -1.0, 1.0);
        const double cosine = sqrt((1.0 - sine) * (1.0 + sine));
        const double turned_sine = per_far * (y * cosine + u * sine), turned_cosine = per_far * (u * cosine - y * sine);
        const double touch = turned_sine <= 0.0 ? INFINITY : u * turned_cosine / turned_sine;
        const double across = clamp(touch, flat ? rim : -base, base);
        const double front = -clamp(fronts[i], flat ? rim : 0.0, base);
        const double down = larger(altitude - cone_side(placed, front, u, base, rim, flat), 0.0);

        slices->front_squared[i] = (y + front) * (y + front) + down * down;
        slices->tangent[i] = y + across;
        slices->height[i] = cone_side(placed, across, u, base, rim, flat);
        slices->foot[i] = 0.0;
    }
}

static inline void see_point(double y, double z, double altitude, double *highest, double *tangent)
{
    const double elevation = (z - altitude) / y;
    if (elevation > *highest || (elevation == *highest && y > *tangent)) {
        *highest = elevation;
        *tangent = y;
    }
}

/* All pairs of crossings are taken for sides: those that are none lie within the polygon and change neither extreme. */
static int wedge(const Placed *placed, double u, double y, double altitude, Slice *slice)
{
    double at[EDGES][2], nearest = INFINITY, highest = -INFINITY, tangent = 0.0, foot = INFINITY;
    int n = 0, hit = 0;

    for (int edge = 0; edge < EDGES; edge++) {
        const double *a = placed->corner[EDGE[edge][0]], *b = placed->corner[EDGE[edge][1]];
        if (a[0] == b[0] || (u < a[0] && u < b[0]) || (u > a[0] && u > b[0]))
            continue;
        at[n][0] = y + a[1] + (u - a[0]) * placed->across_per_m[edge];
        at[n][1] = a[2] + (u - a[0]) * placed->up_per_m[edge];
        n++;
    }
    for (int i = 0; n > 1 && i < n; i++) {
        if (at[i][1] >= 0.0) {
            see_point(at[i][0], at[i][1], altitude, &highest, &tangent);
            foot = smaller(foot, at[i][0]);
        }
    }
    for (int i = 1; i < n; i++) {
        for (int j = 0; j < i; j++) {
            double y0 = at[i][0], z0 = at[i][1], y1 = at[j][0], z1 = at[j][1];
            if (z0 < 0.0 && z1 < 0.0)
                continue;
            if (z0 < 0.0 || z1 < 0.0) {
                const double floor_y = y0 + z0 / (z0 - z1) * (y1 - y0);
                see_point(floor_y, 0.0, altitude, &highest, &tangent);
                foot = smaller(foot, floor_y);
                y0 = z0 < 0.0 ? floor_y : y0;
                y1 = z1 < 0.0 ? floor_y : y1;
                z0 = larger(z0, 0.0);
                z1 = larger(z1, 0.0);
            }
            const double run = y1 - y0, rise = z1 - z0, square = run * run + rise * rise;
            const double part = square > 0.0 ? clamp(((altitude - z0) * rise - y0 * run) / square, 0.0, 1.0) : 0.0;
            const double across = y0 + part * run, up = altitude - z0 - part * rise;
            nearest = smaller(nearest, across * across + up * up);
            hit = 1;
        }
    }
    slice->front_squared = nearest;
    slice->tangent = tangent;
    slice->height = altitude + highest * tangent;
    slice->foot = foot;
    return hit;
}

static void place_wedge(const double *solid, Placed *placed)
{
    for (int v = 0; v < CORNERS; v++) {
        const double l = (v == 0 || v == 3 ? -0.5 : 0.5) * solid[0],
                     w = (v == 0 || v == 1 || v == 4 ? -0.5 : 0.5) * solid[1];
        placed->corner[v][0] = l * placed->cosine - w * placed->sine;
        placed->corner[v][1] = l * placed->sine + w * placed->cosine;
        placed->corner[v][2] = (v < 4 ? 0.0 : solid[2]) - solid[4];
    }
    for (int edge = 0; edge < EDGES; edge++) {
        const double *a = placed->corner[EDGE[edge][0]], *b = placed->corner[EDGE[edge][1]];
        const double per_along = a[0] == b[0] ? 0.0 : 1.0 / (b[0] - a[0]);
        placed->across_per_m[edge] = (b[1] - a[1]) * per_along;
        placed->up_per_m[edge] = (b[2] - a[2]) * per_along;
    }
}

static void place(int64_t kind, const double *solid, Placed *placed)
{
    const double azimuth = kind == CYLINDER ? solid[2] : kind == WEDGE ? solid[3] : 0.0;
    double taper;

    placed->sine = kind == CYLINDER || kind == WEDGE ? sin(azimuth) : 0.0;
    placed->cosine = kind == CYLINDER || kind == WEDGE ? cos(azimuth) : 1.0;
    switch (kind) {
    case SPHERE:
        placed->reach = solid[0];
        placed->top = 2.0 * solid[0] - solid[1];
        break;
    case CYLINDER:
        placed->reach = sqrt(solid[0] * solid[0] + 0.25 * solid[1] * solid[1]);
        placed->top = 2.0 * solid[0] - solid[3];
        if (placed->cosine < 0.0) { /* an axis has no sign */
            placed->sine = -placed->sine;
            placed->cosine = -placed->cosine;
        }
        placed->per_sine = 1.0 / fabs(placed->sine);
        placed->per_cosine = 1.0 / placed->cosine;
        break;
    case CONE:
        placed->reach = solid[0];
        placed->height = placed->top = solid[2] - solid[3];
        placed->base_radius = solid[0] - (solid[0] - solid[1]) * (solid[3] / solid[2]);
        taper = (placed->base_radius - solid[1]) / placed->height;
        /* Dividing by a smaller taper would make heights of rounding. */
        placed->rim_radius = taper < 1e-9 ? placed->base_radius : solid[1];
        placed->taper = taper < 1e-9 ? 0.0 : taper;
        placed->per_taper = taper < 1e-9 ? 1.0 : 1.0 / taper;
        break;
    default:
        placed->reach = 0.5 * sqrt(solid[0] * solid[0] + solid[1] * solid[1]);
        placed->top = solid[2] - solid[4];
        place_wedge(solid, placed);
    }
}

/* Columns at which the highlight begins, the shadow begins and the shadow ends in each slice of a block. */
WIDE static void find_ends(const Image *image, double altitude, Slices *slices)
{
    const double per_metre = 1.0 / image->column_m, flat = image->altitude * image->altitude,
                 last = (double)image->n_columns;

    for (int64_t i = 0; i < slices->n; i++) {
        const double down = altitude - slices->height[i], shadow_end = altitude * slices->tangent[i] / down;
        const double highest = slices->tangent[i] * slices->tangent[i] + down * down;
        const double foot = slices->foot[i] * slices->foot[i] + altitude * altitude;
        const double tangent = slices->foot[i] > 0.0 ? larger(highest, foot) : highest;
        const double end = shadow_end * shadow_end + altitude * altitude;
        const double near_m = sqrt(larger(slices->front_squared[i] - flat, 0.0)),
                     top_m = sqrt(larger(tangent - flat, 0.0));
        const double end_m = sqrt(larger(end - flat, 0.0));
        const double front = clamp((near_m - image->first_m + -image->smear) * per_metre, 0.0, last);
        const double between = larger(clamp((top_m - image->first_m + image->smear) * per_metre, 0.0, last), front);
        slices->end[0][i] = front;
        slices->end[1][i] = between;
        slices->end[2][i] = larger(clamp((end_m - image->first_m + 0.0) * per_metre, 0.0, last), between);
    }
}

static void cut(int64_t kind, const double *solid, const Placed *placed, const Image *image, double altitude,
                Slices *slices)
{
    switch (kind) {
    case SPHERE:
        spheres(solid, altitude, slices);
        break;
    case CYLINDER:
        cylinders(solid, placed, altitude, slices);
        break;
    case CONE:
        cones(placed, altitude, slices);
        break;
    default:
        for (int64_t i = 0; i < slices->n; i++) {
            Slice slice = {0.0, 0.0, 0.0, 0.0};
            slices->hit[i] = wedge(placed, slices->u[i], slices->y[i], altitude, &slice);
            slices->front_squared[i] = slice.front_squared;
            slices->tangent[i] = slice.tangent;
            slices->height[i] = slice.height;
            slices->foot[i] = slice.foot;
        }
    }
    find_ends(image, altitude, slices);
}

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

static double cost_of(int64_t kind, const double *hypothesis, const Image *image, const Beam *beam, double *mean)
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

    place(kind, solid, &placed);
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
        cut(kind, solid, &placed, image, altitude, &slices);
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
    if (!(part[0].count >= 4.0 && part[1].count >= 8.0 && part[2].count > 0.0))
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

static Beam beam_of(int64_t n_taps, const double *angle, const double *share, int64_t n_steps)
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

static Image image_of(int64_t n_rows, int64_t n_columns, const double *scalars, const double *echoes,
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
    const Image image = image_of(n_rows, n_columns, scalars, echoes, counts);
    const Beam beam = beam_of(n_taps, angle, share, n_steps);

    for (int64_t i = 0; i < n; i++) {
        cost[i] = cost_of(kind, hypotheses + FIELDS * i, &image, &beam, mean + 3 * i);
        if (cost[i] >= FORBIDDEN)
            mean[3 * i] = mean[3 * i + 1] = mean[3 * i + 2] = NAN;
    }
}

/* ends (n, n_rows, n_taps, 3): columns as cut() finds them, 0 where it finds none. The rest as above. */
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
        place(kind, solid, &placed);
        for (int64_t slot = 0; slot < n_rows * n_taps; slot += slices.n) {
            slices.n = slot + BLOCK < n_rows * n_taps ? BLOCK : n_rows * n_taps - slot;
            for (int64_t k = 0; k < slices.n; k++) {
                const int64_t row = (slot + k) / n_taps, tap = (slot + k) % n_taps;
                slices.u[k] = ((double)row + 0.5) * image.row_m - hypothesis[0] + angle[tap] * slant;
                slices.y[k] = y - slices.u[k] * image.shear;
            }
            cut(kind, solid, &placed, &image, altitude, &slices);
            for (int64_t k = 0; k < slices.n; k++)
                for (int end = 0; end < N_ENDS; end++)
                    *ends++ = slices.hit[k] ? slices.end[end][k] : 0.0;
        }
    }
}

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
    return cost_of(kind, hypothesis, image, beam, mean) + 0.5 * (altitude * altitude + burial * burial) + chart->fixed;
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
    const Image image = image_of(n_rows, n_columns, scalars, echoes, counts);
    const Beam beam = beam_of(n_taps, angle, share, n_scoring_steps);
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
