/* Costs of solids as explanations of an image, see shape.py for their definition.
 *
 * Slices are those of auv_mcm.classify.slices and polyhedron, one at a time instead of in arrays. Newton's methods start from simpler
 * bounds and go on until they stand still; as they close in from one side, that finds the same point.
 */

#include <math.h>
#include <stdint.h>

enum { SPHERE, CYLINDER, CONE, WEDGE };
enum { FIELDS = 8, MAX_TAPS = 15, PIECE = 4, EDGES = 9, MAX_STEPS = 60 };

#define FORBIDDEN 1e12
#define LEAST_MEAN 1e-6
#define LEVEL 1e-15

typedef struct {
    double sine, cosine, reach, top;
    double vertices[6][3];
} Placed;

typedef struct {
    double front, tangent, height, foot; /* slant range; ground range and height; ground range of a vertical face, if any is seen */
} Slice;

typedef struct {
    int64_t n_rows, n_columns;
    double row_m, column_m, first_m, altitude, weight, smear, shear;
    const double *echoes, *counts;
    double total, n_total;
} Image;

static const int EDGE[EDGES][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {1, 4}, {2, 5}, {4, 5}, {0, 4}, {3, 5}};

static inline double smaller(double a, double b) { return a < b ? a : b; }
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double clamp(double value, double low, double high) { return smaller(larger(value, low), high); }

static inline double half_chord(double radius, double lateral)
{
    return sqrt(larger((radius - lateral) * (radius + lateral), 0.0));
}

static inline void interval(double offset, double slope, double half_width, double *low, double *high)
{
    if (fabs(slope) < LEVEL) {
        *high = fabs(offset) <= half_width ? INFINITY : -INFINITY;
        *low = -*high;
        return;
    }
    const double way = slope < 0.0 ? -offset : offset, steep = 1.0 / fabs(slope);
    *low = (-half_width - way) * steep;
    *high = (half_width - way) * steep;
}

static double arch_front(double radius, double lateral, double cosine, double sonar, double rise, double y)
{
    const double first = sonar / radius, second = rise / radius, squeeze = cosine * cosine;
    const double square = first * first + second * second;
    double t = larger(sqrt(square) - 1.0, squeeze > 1e-30 ? (fabs(first) - 1.0) / squeeze : 0.0);

    if (square <= 1.0)
        return -INFINITY;
    for (int step = 0; step < MAX_STEPS; step++) {
        const double wide = 1.0 / (squeeze * t + 1.0), high = 1.0 / (t + 1.0);
        const double a = first * wide, b = second * high, value = a * a + b * b;
        const double excess = value - 1.0, root = sqrt(value);
        const double move = value * (excess / (root + 1.0)) / (a * a * squeeze * wide + b * b * high);
        t = larger(t + move, 0.0);
        if (fabs(move) <= 1e-13 * (1.0 + t))
            break;
    }
    return -(y + lateral * cosine * t) / (squeeze * t + 1.0);
}

static int arch(double radius, double centre, double lateral, double cosine, double end_low, double end_high, double y, double altitude,
                Slice *slice)
{
    const double sunk = smaller(centre, 0.0);
    double low, high;

    if (!(radius > 0.0) || radius <= -sunk)
        return 0;
    interval(lateral, cosine, half_chord(radius, sunk), &low, &high);
    low = larger(low, end_low);
    high = smaller(high, end_high);
    if (!(low <= high))
        return 0;

    const double sonar = lateral - cosine * y, rise = altitude - centre;
    const double square = sonar * sonar + rise * rise, power = square - radius * radius;
    const double touch = (radius * radius * sonar + radius * sqrt(larger(power, 0.0)) * rise) / square;
    const double across = clamp(power > 0.0 ? (touch - lateral) / larger(cosine, LEVEL) : -INFINITY, low, high);
    const double front = clamp(arch_front(radius, lateral, cosine, sonar, rise, y), low, high);
    const double half = half_chord(radius, lateral + cosine * front);
    const double down = altitude - clamp(altitude, larger(centre - half, 0.0), larger(centre + half, 0.0));

    slice->front = sqrt((y + front) * (y + front) + down * down);
    slice->tangent = y + across;
    slice->height = larger(centre + half_chord(radius, lateral + cosine * across), 0.0);
    return 1;
}

static int sphere(const double *solid, double u, double y, double altitude, Slice *slice)
{
    if (!(fabs(u) < solid[0]))
        return 0;
    return arch(half_chord(solid[0], u), solid[0] - solid[1], 0.0, 1.0, -INFINITY, INFINITY, y, altitude, slice);
}

static int cylinder(const double *solid, const Placed *placed, double u, double y, double altitude, Slice *slice)
{
    double low, high;
    interval(u * placed->cosine, placed->sine, 0.5 * solid[1], &low, &high);
    return arch(solid[0], solid[0] - solid[3], -u * placed->sine, placed->cosine, low, high, y, altitude, slice);
}

static double cone_side(double across, double u, double base, double rim, double base_radius, double k, double height, int flat)
{
    if (flat && fabs(across) <= rim)
        return height;
    if (fabs(across) >= base)
        return 0.0;
    return clamp((base_radius - sqrt(across * across + u * u)) / (k > 0.0 ? k : 1.0), 0.0, height);
}

/* How far before the axis the sloping side is nearest. */
static double cone_front(double base_radius, double k, double u, double y, double altitude)
{
    u = larger(u, 1e-12 * base_radius);
    const double m = base_radius - k * altitude, slope = k * k * larger(y, 1e-6), target = 1.0 + k * k;
    const double at_corner = slope + m, saturated = (target - m / u) / slope;
    const double through_origin = at_corner > 0.0 ? target / at_corner : INFINITY;
    double x = m < 0.0 ? smaller(through_origin, saturated) : larger(through_origin, saturated);

    for (int step = 0; step < MAX_STEPS; step++) {
        const double shrink = 1.0 / sqrt(1.0 + u * u * x * x);
        const double move = (slope * x + m * x * shrink - target) / (slope + m * shrink * shrink * shrink);
        x -= move;
        if (fabs(move) <= 1e-13 * fabs(x))
            break;
    }
    return 1.0 / x;
}

static int cone(const double *solid, double u, double y, double altitude, Slice *slice)
{
    const double height = solid[2] - solid[3], base_radius = solid[0] - (solid[0] - solid[1]) * (solid[3] / solid[2]);
    u = fabs(u);
    if (!(u <= base_radius && height > 0.0))
        return 0;
    const double taper = (base_radius - solid[1]) / height;
    /* Dividing by a smaller taper would make heights of rounding. */
    const double top = taper < 1e-9 ? base_radius : solid[1], k = taper < 1e-9 ? 0.0 : taper, apex = base_radius - k * altitude;
    const double base = half_chord(base_radius, u), rim = half_chord(top, u);
    const int flat = u <= top;

    const double far = larger(sqrt(u * u + y * y), 1e-300), sine = clamp(apex / far, -1.0, 1.0);
    const double cosine = sqrt((1.0 - sine) * (1.0 + sine));
    const double turned_sine = y / far * cosine + u / far * sine, turned_cosine = u / far * cosine - y / far * sine;
    const double touch = turned_sine <= 0.0 ? INFINITY : u * turned_cosine / turned_sine;
    const double across = clamp(touch, flat ? rim : -base, base);
    const double front = -clamp(cone_front(base_radius, larger(k, 1e-9), u, y, altitude), flat ? rim : 0.0, base);
    const double down = larger(altitude - cone_side(front, u, base, rim, base_radius, k, height, flat), 0.0);

    slice->front = sqrt((y + front) * (y + front) + down * down);
    slice->tangent = y + across;
    slice->height = cone_side(across, u, base, rim, base_radius, k, height, flat);
    return 1;
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
        const double *a = placed->vertices[EDGE[edge][0]], *b = placed->vertices[EDGE[edge][1]];
        if (a[0] == b[0] || (u < a[0] && u < b[0]) || (u > a[0] && u > b[0]))
            continue;
        const double part = (u - a[0]) / (b[0] - a[0]);
        at[n][0] = y + a[1] + part * (b[1] - a[1]);
        at[n][1] = a[2] + part * (b[2] - a[2]);
        n++;
    }
    for (int i = 1; i < n; i++) {
        for (int j = 0; j < i; j++) {
            double y0 = at[i][0], z0 = at[i][1], y1 = at[j][0], z1 = at[j][1];
            if (z0 < 0.0 && z1 < 0.0)
                continue;
            if (z0 < 0.0) {
                y0 += z0 / (z0 - z1) * (y1 - y0);
                z0 = 0.0;
            } else if (z1 < 0.0) {
                y1 += z1 / (z1 - z0) * (y0 - y1);
                z1 = 0.0;
            }
            const double run = y1 - y0, rise = z1 - z0, square = run * run + rise * rise;
            const double part = square > 0.0 ? clamp(((altitude - z0) * rise - y0 * run) / square, 0.0, 1.0) : 0.0;
            const double across = y0 + part * run, up = altitude - z0 - part * rise;
            nearest = smaller(nearest, across * across + up * up);
            see_point(y0, z0, altitude, &highest, &tangent);
            see_point(y1, z1, altitude, &highest, &tangent);
            foot = smaller(foot, smaller(y0, y1));
            hit = 1;
        }
    }
    slice->front = sqrt(nearest);
    slice->tangent = tangent;
    slice->height = altitude + highest * tangent;
    slice->foot = foot;
    return hit;
}

static void place(int64_t kind, const double *solid, Placed *placed)
{
    const double azimuth = kind == CYLINDER ? solid[2] : kind == WEDGE ? solid[3] : 0.0;
    placed->sine = sin(azimuth);
    placed->cosine = cos(azimuth);
    switch (kind) {
    case SPHERE:
        placed->reach = solid[0];
        placed->top = 2.0 * solid[0] - solid[1];
        break;
    case CYLINDER:
        placed->reach = sqrt(solid[0] * solid[0] + 0.25 * solid[1] * solid[1]);
        placed->top = 2.0 * solid[0] - solid[3];
        break;
    case CONE:
        placed->reach = solid[0];
        placed->top = solid[2] - solid[3];
        break;
    default:
        placed->reach = 0.5 * sqrt(solid[0] * solid[0] + solid[1] * solid[1]);
        placed->top = solid[2] - solid[4];
        for (int v = 0; v < 6; v++) {
            const double l = (v == 0 || v == 3 ? -0.5 : 0.5) * solid[0], w = (v == 0 || v == 1 || v == 4 ? -0.5 : 0.5) * solid[1];
            placed->vertices[v][0] = l * placed->cosine - w * placed->sine;
            placed->vertices[v][1] = l * placed->sine + w * placed->cosine;
            placed->vertices[v][2] = (v < 4 ? 0.0 : solid[2]) - solid[4];
        }
    }
    if (kind == CYLINDER && placed->cosine < 0.0) {
        placed->sine = -placed->sine;
        placed->cosine = -placed->cosine;
    }
}

static inline double up_to(const double *sums, double column, int64_t n_columns)
{
    const int64_t left = column < (double)(n_columns - 1) ? (int64_t)column : n_columns - 1;
    return sums[left] + (sums[left + 1] - sums[left]) * (column - (double)left);
}

static int cut(int64_t kind, const double *solid, const Placed *placed, const Image *image, double altitude, double u, double y,
               double *ends)
{
    Slice slice = {0.0, 0.0, 0.0, 0.0};
    int hit;

    switch (kind) {
    case SPHERE:
        hit = sphere(solid, u, y, altitude, &slice);
        break;
    case CYLINDER:
        hit = cylinder(solid, placed, u, y, altitude, &slice);
        break;
    case CONE:
        hit = cone(solid, u, y, altitude, &slice);
        break;
    default:
        hit = wedge(placed, u, y, altitude, &slice);
    }
    if (!hit)
        return 0;
    const double down = altitude - slice.height, per_metre = 1.0 / image->column_m, shadow_end = altitude * slice.tangent / down;
    const double tangent = slice.tangent * slice.tangent + down * down, foot = slice.foot * slice.foot + altitude * altitude;
    const double range[3] = {
        slice.front,
        sqrt(slice.foot > 0.0 ? larger(tangent, foot) : tangent),
        sqrt(shadow_end * shadow_end + altitude * altitude),
    };
    for (int k = 0; k < 3; k++) {
        const double ground = sqrt(larger((range[k] - image->altitude) * (range[k] + image->altitude), 0.0));
        const double smear = k == 0 ? -image->smear : k == 1 ? image->smear : 0.0;
        ends[k] = clamp((ground - image->first_m + smear) * per_metre, 0.0, (double)image->n_columns);
    }
    ends[1] = larger(ends[1], ends[0]);
    ends[2] = larger(ends[2], ends[1]);
    return 1;
}

/* Cuts a row into pieces of one mixture each: count, sum, share of highlight, share of shadow. Returns how many. */
static int64_t mix_row(const double (*ends)[3], const double *share, int n_taps, const double *echoes, const double *counts,
                       int64_t n_columns, double *pieces)
{
    double at[3 * MAX_TAPS], highlight[3 * MAX_TAPS], shadow[3 * MAX_TAPS];
    double is_highlight = 0.0, is_shadow = 0.0, last_count, last_sum;
    int n = 0;
    int64_t n_pieces = 0;

    for (int k = 0; k < 3; k++) {
        for (int tap = 0; tap < n_taps; tap++) {
            const double here = ends[tap][k];
            int place = n++;
            for (; place > 0 && at[place - 1] > here; place--) {
                at[place] = at[place - 1];
                highlight[place] = highlight[place - 1];
                shadow[place] = shadow[place - 1];
            }
            at[place] = here;
            highlight[place] = k == 0 ? share[tap] : k == 1 ? -share[tap] : 0.0;
            shadow[place] = k == 0 ? 0.0 : k == 1 ? share[tap] : -share[tap];
        }
    }
    last_count = up_to(counts, at[0], n_columns);
    last_sum = up_to(echoes, at[0], n_columns);
    for (int i = 0; i + 1 < n; i++) {
        is_highlight += highlight[i];
        is_shadow += shadow[i];
        if (at[i + 1] <= at[i])
            continue;
        const double count = up_to(counts, at[i + 1], n_columns), sum = up_to(echoes, at[i + 1], n_columns);
        double *piece = pieces + PIECE * n_pieces++;
        piece[0] = count - last_count;
        piece[1] = sum - last_sum;
        piece[2] = is_highlight;
        piece[3] = is_shadow;
        last_count = count;
        last_sum = sum;
    }
    return n_pieces;
}

static inline double misfit(double count, double sum, double mean) { return count * log(mean) + sum / mean - count; }

/* One step of Fisher scoring for the logarithms of the means of highlight, shadow and floor. */
static void improve(const double *pieces, int64_t n_pieces, double floor_count, double floor_sum, double *mean)
{
    double h[3][3] = {{0.0}}, g[3] = {0.0};

    for (int64_t i = 0; i <= n_pieces; i++) {
        const double *piece = pieces + PIECE * i;
        const double count = i < n_pieces ? piece[0] : floor_count, sum = i < n_pieces ? piece[1] : floor_sum;
        double a[3] = {i < n_pieces ? piece[2] : 0.0, i < n_pieces ? piece[3] : 0.0, 0.0};
        a[2] = (1.0 - a[0] - a[1]) * mean[2];
        a[0] *= mean[0];
        a[1] *= mean[1];
        const double scale = 1.0 / (a[0] + a[1] + a[2]), surprise = sum * scale - count;
        for (int j = 0; j < 3; j++) {
            a[j] *= scale;
            g[j] += a[j] * surprise;
            for (int k = 0; k <= j; k++)
                h[j][k] += count * a[j] * a[k];
        }
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

static double cost_of(int64_t kind, const double *hypothesis, const Image *image, int n_taps, const double *angle, const double *share,
                      int64_t n_steps, double *pieces, double *mean)
{
    const double *solid = hypothesis + 3, along = hypothesis[0], y = hypothesis[1], altitude = image->altitude * hypothesis[2];
    const double slant = sqrt(y * y + altitude * altitude);
    double count[3] = {0.0}, sum[3] = {0.0}, spread = 0.0, ends[MAX_TAPS][3], cost = 0.0;
    int64_t n_pieces = 0;
    Placed placed;

    place(kind, solid, &placed);
    if (!(y > placed.reach * (1.0 + fabs(image->shear)) && altitude >= 1.2 * placed.top && placed.top > 0.0))
        return FORBIDDEN;
    for (int tap = 0; tap < n_taps; tap++)
        spread = larger(spread, fabs(angle[tap]) * slant);
    const double low = (along - placed.reach - spread) / image->row_m - 1.0, high = (along + placed.reach + spread) / image->row_m + 1.0;
    const int64_t first = (int64_t)clamp(low, 0.0, (double)image->n_rows), stop = (int64_t)clamp(high, 0.0, (double)image->n_rows);

    for (int64_t row = first; row < stop; row++) {
        const double *echoes = image->echoes + row * (image->n_columns + 1), *counts = image->counts + row * (image->n_columns + 1);
        const double u = ((double)row + 0.5) * image->row_m - along;
        int any = 0;
        for (int tap = 0; tap < n_taps; tap++) {
            const double off = u + angle[tap] * slant;
            const int hit = cut(kind, solid, &placed, image, altitude, off, y - off * image->shear, ends[tap]);
            if (!hit)
                ends[tap][0] = ends[tap][1] = ends[tap][2] = 0.0;
            any |= hit;
            if (hit && tap == n_taps / 2) {
                for (int k = 0; k < 2; k++) {
                    count[k] += up_to(counts, ends[tap][k + 1], image->n_columns) - up_to(counts, ends[tap][k], image->n_columns);
                    sum[k] += up_to(echoes, ends[tap][k + 1], image->n_columns) - up_to(echoes, ends[tap][k], image->n_columns);
                }
            }
        }
        if (any && n_taps > 1)
            n_pieces += mix_row((const double(*)[3])ends, share, n_taps, echoes, counts, image->n_columns, pieces + PIECE * n_pieces);
    }
    count[2] = image->n_total - count[0] - count[1];
    sum[2] = image->total - sum[0] - sum[1];
    for (int k = 0; k < 3; k++)
        mean[k] = larger(count[k] > 0.0 ? sum[k] / count[k] : 0.0, LEAST_MEAN);
    if (!(count[0] >= 4.0 && count[1] >= 8.0 && count[2] > 0.0))
        return FORBIDDEN;
    if (n_taps > 1) {
        double floor_count = image->n_total, floor_sum = image->total;
        for (int64_t i = 0; i < n_pieces; i++) {
            floor_count -= pieces[PIECE * i];
            floor_sum -= pieces[PIECE * i + 1];
        }
        for (int64_t step = 0; step < n_steps; step++)
            improve(pieces, n_pieces, floor_count, floor_sum, mean);
        cost = misfit(floor_count, floor_sum, mean[2]);
        for (int64_t i = 0; i < n_pieces; i++) {
            const double *piece = pieces + PIECE * i;
            cost += misfit(piece[0], piece[1], piece[2] * mean[0] + piece[3] * mean[1] + (1.0 - piece[2] - piece[3]) * mean[2]);
        }
    } else {
        for (int k = 0; k < 3; k++)
            cost += misfit(count[k], sum[k], mean[k]);
    }
    if (!(mean[1] <= 0.6 * mean[2] && mean[0] >= 1.3 * mean[2]))
        return FORBIDDEN;
    return image->weight * cost;
}

/* hypotheses (n, 8), echoes and counts (n_rows, n_columns + 1), scalars: row, column, first ground range, altitude in metres,
 * independent samples per pixel, smear in metres, shear. angle, share (n_taps). pieces: scratch for 4 * n_rows * 3 * n_taps numbers. cost (n), mean (n, 3).
 */
void auv_mcm_shape_costs(int64_t kind, int64_t n, const double *hypotheses, int64_t n_rows, int64_t n_columns, const double *scalars,
                         const double *echoes, const double *counts, int64_t n_taps, const double *angle, const double *share,
                         int64_t n_steps, double *pieces, double *cost, double *mean)
{
    Image image = {n_rows, n_columns, scalars[0], scalars[1], scalars[2], scalars[3], scalars[4], scalars[5], scalars[6], echoes, counts, 0.0, 0.0};

    for (int64_t row = 0; row < n_rows; row++) {
        image.total += echoes[row * (n_columns + 1) + n_columns];
        image.n_total += counts[row * (n_columns + 1) + n_columns];
    }
    for (int64_t i = 0; i < n; i++) {
        cost[i] = cost_of(kind, hypotheses + FIELDS * i, &image, (int)n_taps, angle, share, n_steps, pieces, mean + 3 * i);
        if (cost[i] >= FORBIDDEN)
            mean[3 * i] = mean[3 * i + 1] = mean[3 * i + 2] = NAN;
    }
}
