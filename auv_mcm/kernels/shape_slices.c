/* Slices of solids, those of auv_mcm.solids.slices and polyhedron, and the columns at which their images end.
 *
 * A block of slices at a time so that the compiler can use vectors. Newton's methods start from simpler bounds and go
 * on until they stand still; as they close in from one side, that finds the same point.
 */

#include "shape.h"

enum { MAX_STEPS = 60 };

#define LEVEL 1e-15
#define STILL 1e-7 /* a step of Newton's method of this size, relative, leaves an error of its square */

typedef struct {
    double front_squared, tangent, height,
        foot; /* slant range; ground range and height; ground range of a vertical face, if any is seen */
} Slice;

static const int EDGE[EDGES][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {1, 4}, {2, 5}, {4, 5}, {0, 4}, {3, 5}};

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

void shape_place(int64_t kind, const double *solid, Placed *placed)
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

void shape_cut(int64_t kind, const double *solid, const Placed *placed, const Image *image, double altitude,
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
