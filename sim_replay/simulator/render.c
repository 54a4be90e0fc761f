/* Echo energy of rays over a height field, one vertical slice per ray. render.py says what is computed and holds the numpy twin, which
 * gives the same bytes: same operations in the same order, no fused multiply-adds, no function of libm but the square root.
 */

#include <math.h>
#include <stdint.h>

/* Raised whenever a signature changes, so that a stale library is refused instead of called wrongly. */
#define AUV_MCM_SIMULATOR_VERSION 1

/* Wider vectors where the processor has them; they round alike. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

#define PATCH_SHIFT 8
#define PATCH_MASK 255
#define NODES 257
#define TABLE 4096
#define LINE_WIDTH 12
#define BODY_WIDTH 20

int32_t auv_mcm_simulator_version(void) { return AUV_MCM_SIMULATOR_VERSION; }

enum line_field { L_NORTH, L_EAST, L_STEP_NORTH, L_STEP_EAST, L_ELEVATION, L_SLANT, L_AXIS_COS, L_AXIS_SIN, L_WEIGHT, L_PING };
enum body_field { B_KIND, B_EAST, B_NORTH, B_REACH, B_SIN, B_COS, B_BASE, B_MATERIAL, B_P0, B_P1, B_P2, B_P3, B_P4, B_PLANE, B_SIDES, B_TOPS };
enum body_kind { ELLIPSOID, CYLINDER, CONE, POLYHEDRON, TORUS, SCAR, MOAT };

typedef struct {
    double z, slope_u, slope_v;
    int covered;
} top;

/* Height over the body's base, and slopes, at (u, v) in the body's axes. For SCAR and MOAT z is what the floor is moved by. */
static inline top body_top(const double *restrict b, const double *restrict planes, double u, double v)
{
    const double p0 = b[B_P0], p1 = b[B_P1], p2 = b[B_P2], p3 = b[B_P3], p4 = b[B_P4];
    top out = {0.0, 0.0, 0.0, 0};
    switch ((int)b[B_KIND]) {
    case ELLIPSOID: { /* semi-axes p0, p1, p2; centre at p3 */
        const double s = u / p0, t = v / p1, inside = 1.0 - s * s - t * t;
        if (inside > 0.0) {
            const double root = sqrt(inside);
            out = (top){p3 + p2 * root, -p2 * s / (p0 * root), -p2 * t / (p1 * root), 1};
        }
        break;
    }
    case CYLINDER: { /* radius p0, half length p1, centre at p2, sine p3 >= 0 and cosine p4 of the tilt: +u end raised */
        const double inside = p0 * p0 - v * v;
        if (inside > 0.0) {
            const double root = sqrt(inside), rise = p3 / p4, half = root / p4;
            const double z = u * rise + half, along = u * p4 + z * p3;
            if (along <= p1) {
                if (along >= -p1)
                    out = (top){p2 + z, rise, -v / (root * p4), 1};
            } else if (p3 > 0.0) {
                const double end = (p1 - u * p4) / p3;
                if (end >= u * rise - half)
                    out = (top){p2 + end, -p4 / p3, 0.0, 1};
            }
        }
        break;
    }
    case CONE: { /* base radius p0, top radius p1, height p2, pushed p3 into the floor */
        const double across = sqrt(u * u + v * v);
        if (across <= p1) {
            out = (top){p2 - p3, 0.0, 0.0, 1};
        } else if (across < p0) {
            const double steep = p2 / (p0 - p1);
            out = (top){(p0 - across) * steep - p3, -steep * u / across, -steep * v / across, 1};
        }
        break;
    }
    case POLYHEDRON: {
        const double *plane = planes + 3 * (int64_t)b[B_PLANE];
        const int64_t n_sides = (int64_t)b[B_SIDES], n_tops = (int64_t)b[B_TOPS];
        for (int64_t k = 0; k < n_sides; k++, plane += 3)
            if (plane[0] * u + plane[1] * v > plane[2])
                return out;
        out.covered = 1;
        for (int64_t k = 0; k < n_tops; k++, plane += 3) {
            const double z = plane[0] * u + plane[1] * v + plane[2];
            if (k == 0 || z < out.z) {
                out.z = z;
                out.slope_u = plane[0];
                out.slope_v = plane[1];
            }
        }
        break;
    }
    case TORUS: { /* ring radius p0, of half width p1 and half height p2, centre at p3 */
        const double across = sqrt(u * u + v * v), w = (across - p0) / p1, inside = 1.0 - w * w;
        if (inside > 0.0 && across > 0.0) {
            const double root = sqrt(inside), steep = -p2 * w / (p1 * root);
            out = (top){p3 + p2 * root, steep * u / across, steep * v / across, 1};
        }
        break;
    }
    case SCAR: { /* half length p0, half width p1 of trench and banks, depth p2 */
        const double s = u / p0, t = v / p1, along = 1.0 - s * s, across = 1.0 - t * t;
        if (along > 0.0 && across > 0.0) {
            const double end = along < 0.19 ? along / 0.19 : 1.0, shape = across * across * (1.0 - 6.0 * t * t);
            const double steep = -4.0 * t * across * (1.0 - 6.0 * t * t) - 12.0 * t * across * across;
            out = (top){-p2 * end * shape, 0.0, -p2 * end * steep / p1, 1};
        }
        break;
    }
    case MOAT: { /* semi-axes p0, p1 of the ring, depth p2, half width p3 in parts of the axes */
        const double s = u / p0, t = v / p1, across = sqrt(s * s + t * t), w = (across - 1.0) / p3, inside = 1.0 - w * w;
        if (inside > 0.0 && across > 0.0) {
            const double steep = 4.0 * p2 * w * inside / (p3 * across);
            out = (top){-p2 * inside * inside, steep * s / p0, steep * t / p1, 1};
        }
        break;
    }
    }
    return out;
}

/* Horizontal normal of the body's wall next to (u, v), a place outside of it. */
static inline void body_wall(const double *restrict b, const double *restrict planes, double u, double v, double *normal_u, double *normal_v)
{
    *normal_u = u;
    *normal_v = v;
    switch ((int)b[B_KIND]) {
    case ELLIPSOID:
        *normal_u = u / (b[B_P0] * b[B_P0]);
        *normal_v = v / (b[B_P1] * b[B_P1]);
        break;
    case CYLINDER: {
        const double past_end = fabs(u) - b[B_P1], past_side = fabs(v) - b[B_P0];
        if (past_end > past_side)
            *normal_v = 0.0;
        else
            *normal_u = 0.0;
        break;
    }
    case POLYHEDRON: {
        const double *plane = planes + 3 * (int64_t)b[B_PLANE];
        double worst = -INFINITY;
        for (int64_t k = 0; k < (int64_t)b[B_SIDES]; k++, plane += 3) {
            const double outside = plane[0] * u + plane[1] * v - plane[2];
            if (outside > worst) {
                worst = outside;
                *normal_u = plane[0];
                *normal_v = plane[1];
            }
        }
        break;
    }
    default:
        break;
    }
}

/* Put the bodies on the profile of one ray. owner: index of the body that a node lies on, -1 for the floor. */
static void raise_bodies(const double *restrict line, int64_t n_nodes, double cell_m, double origin_north, double origin_east, int64_t n_bodies,
                         const double *restrict bodies, const double *restrict planes, float *restrict z, float *restrict q,
                         float *restrict texture, int32_t *restrict material, int32_t *restrict owner)
{
    const double step_m = cell_m * sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
    const double away_north = line[L_STEP_NORTH] * cell_m / step_m, away_east = line[L_STEP_EAST] * cell_m / step_m;
    const double ahead_north = -away_east, ahead_east = away_north; /* a right angle from the ray; its sign is free */
    for (int64_t k = 0; k < n_bodies; k++) {
        const double *b = bodies + k * BODY_WIDTH;
        const double north = origin_north + line[L_NORTH] * cell_m - b[B_NORTH], east = origin_east + line[L_EAST] * cell_m - b[B_EAST];
        const double along = -(north * away_north + east * away_east), miss = north * ahead_north + east * ahead_east;
        const double inside = b[B_REACH] * b[B_REACH] - miss * miss;
        if (!(inside > 0.0))
            continue;
        const double half = sqrt(inside);
        const double low = ceil((along - half) / step_m), high = floor((along + half) / step_m);
        if (high < 0.0 || low > (double)(n_nodes - 1))
            continue;
        const int64_t first = low < 0.0 ? 0 : (int64_t)low, last = high > (double)(n_nodes - 1) ? n_nodes - 1 : (int64_t)high;
        const double u0 = east * b[B_SIN] + north * b[B_COS], v0 = east * b[B_COS] - north * b[B_SIN];
        const double du = (away_east * b[B_SIN] + away_north * b[B_COS]) * step_m;
        const double dv = (away_east * b[B_COS] - away_north * b[B_SIN]) * step_m;
        const double ahead_u = ahead_east * b[B_SIN] + ahead_north * b[B_COS], ahead_v = ahead_east * b[B_COS] - ahead_north * b[B_SIN];
        const int moves_floor = b[B_KIND] >= SCAR;
        for (int64_t j = first; j <= last; j++) {
            const double u = u0 + (double)j * du, v = v0 + (double)j * dv;
            const top t = body_top(b, planes, u, v);
            if (!t.covered)
                continue;
            const double slope = t.slope_u * ahead_u + t.slope_v * ahead_v;
            if (moves_floor) {
                z[j] += (float)t.z;
                q[j] += (float)slope;
            } else if ((float)(b[B_BASE] + t.z) > z[j]) {
                z[j] = (float)(b[B_BASE] + t.z);
                q[j] = (float)slope;
                texture[j] = 1.0f;
                material[j] = (int32_t)b[B_MATERIAL];
                owner[j] = (int32_t)k;
            }
        }
    }
}

/* A wall stands between two nodes of different owners: it belongs to the higher one, and its slope along the track follows from how it
 * is turned. Facet j lies between nodes j - 1 and j and carries what node j carries, so this may overwrite it. Backwards, because what
 * facet j takes from node j - 1 must not have been overwritten. */
static void turn_walls(const double *restrict line, int64_t n_nodes, double cell_m, double origin_north, double origin_east,
                       const double *restrict bodies, const double *restrict planes, const float *restrict z, float *restrict q,
                       float *restrict texture, int32_t *restrict material, const int32_t *restrict owner)
{
    const double step_m = cell_m * sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
    const double away_north = line[L_STEP_NORTH] * cell_m / step_m, away_east = line[L_STEP_EAST] * cell_m / step_m;
    const double ahead_north = -away_east, ahead_east = away_north;
    for (int64_t j = n_nodes - 1; j > 0; j--) {
        if (owner[j] == owner[j - 1])
            continue;
        const int near_is_higher = z[j - 1] > z[j];
        const int64_t inner = near_is_higher ? j - 1 : j, outer = near_is_higher ? j : j - 1;
        texture[j] = texture[inner];
        material[j] = material[inner];
        if (owner[inner] < 0)
            continue;
        const double *b = bodies + (int64_t)owner[inner] * BODY_WIDTH;
        const double north = origin_north + line[L_NORTH] * cell_m - b[B_NORTH], east = origin_east + line[L_EAST] * cell_m - b[B_EAST];
        const double e = east + (double)outer * step_m * away_east, n = north + (double)outer * step_m * away_north;
        double normal_u, normal_v;
        body_wall(b, planes, e * b[B_SIN] + n * b[B_COS], e * b[B_COS] - n * b[B_SIN], &normal_u, &normal_v);
        const double towards = normal_u * (away_east * b[B_SIN] + away_north * b[B_COS]) + normal_v * (away_east * b[B_COS] - away_north * b[B_SIN]);
        const double aside = normal_u * (ahead_east * b[B_SIN] + ahead_north * b[B_COS]) + normal_v * (ahead_east * b[B_COS] - ahead_north * b[B_SIN]);
        const double limit = 20.0 * fabs(towards);
        const double bounded = aside > limit ? limit : aside < -limit ? -limit : aside;
        q[j] = towards != 0.0 ? (float)((double)(z[j] - z[j - 1]) / step_m * (bounded / towards)) : 0.0f;
    }
}

/* Work on one ray: n nodes each. Facet j lies between nodes j - 1 and j; facet 0 is none. */
typedef struct {
    float *restrict z, *restrict slope, *restrict texture, *restrict depth, *restrict r, *restrict t, *restrict lit;
    float *restrict low, *restrict high, *restrict inner;
    int32_t *restrict material, *restrict owner, *restrict first, *restrict last;
} buffers;

/* Cells that the nodes lie in, and where in them. */
WIDE static void place_nodes(int32_t n, double north0, double east0, double step_north, double step_east, int32_t *restrict row,
                             int32_t *restrict column, float *restrict part_north, float *restrict part_east)
{
    for (int32_t j = 0; j < n; j++) {
        const double north = north0 + (double)j * step_north, east = east0 + (double)j * step_east;
        row[j] = (int32_t)north;
        column[j] = (int32_t)east;
        part_north[j] = (float)(north - (double)row[j]);
        part_east[j] = (float)(east - (double)column[j]);
    }
}

/* Slant depth and range, and depression as depth over ground range. */
WIDE static void look_down(int32_t n, float dy, float sonar_m, float slant, const float *restrict z, float *restrict depth,
                           float *restrict r, float *restrict t)
{
    for (int32_t j = 0; j < n; j++) {
        const float y = (float)j * dy, below = sonar_m - z[j], slanted = below * slant;
        depth[j] = slanted;
        r[j] = sqrtf(y * y + slanted * slanted);
        t[j] = below / y;
    }
    t[0] = INFINITY;
}

/* The share of each facet that no nearer node hides. */
static void light(int32_t n, const float *restrict t, float *restrict lit)
{
    float least = INFINITY;
    lit[0] = 0.0f;
    for (int32_t j = 1; j < n; j++) {
        const float here = t[j];
        lit[j] = 0.0f;
        if (here < least) {
            lit[j] = t[j - 1] <= least ? 1.0f : (least - here) / (t[j - 1] - here);
            least = here;
        }
    }
}

/* Which entries of the tables a facet takes, and what they are multiplied by. */
WIDE static void face(int32_t n, float dy, float per_dy, float axis_cos, float axis_sin, float weight, const float *restrict z,
                      const float *restrict slope, const float *restrict depth, const float *restrict r, const float *restrict lit,
                      const int32_t *restrict material, int32_t *restrict entry, int32_t *restrict beam_entry, float *restrict sent)
{
    for (int32_t j = 1; j < n; j++) {
        const float middle_y = ((float)j - 0.5f) * dy, middle_depth = 0.5f * (depth[j] + depth[j - 1]);
        const float middle_r = 0.5f * (r[j] + r[j - 1]), s = (z[j] - z[j - 1]) * per_dy;
        const float stretch = sqrtf(1.0f + s * s + slope[j] * slope[j]);
        const float sine = (middle_depth + middle_y * s) / (middle_r * stretch);
        const float off_axis = (middle_depth * axis_cos - middle_y * axis_sin) / middle_r;
        const int32_t level = (int32_t)(sine * TABLE), angle = (int32_t)((off_axis + 1.0f) * (0.5f * TABLE));
        const int32_t bounded = level < 0 ? 0 : level > TABLE - 1 ? TABLE - 1 : level;
        entry[j] = material[j] * TABLE + bounded;
        beam_entry[j] = angle < 0 ? 0 : angle > TABLE - 1 ? TABLE - 1 : angle;
        sent[j] = stretch * dy * lit[j] * weight * (sine > 0.0f ? 1.0f : 0.0f);
    }
}

/* Each facet's energy is spread evenly over the slant ranges, in bins, that its lit part spans: `low` goes to the bin it starts in, `high`
 * to the bin it ends in if that is another one, `inner` to each bin between; bin n_bins takes what lies beyond. low: in, what the facet
 * sends. Returns the largest number of bins from first to last. */
WIDE static int32_t share(int32_t n, float bins_per_m, float n_bins, const float *restrict r, const float *restrict lit, float *restrict low,
                          float *restrict high, float *restrict inner, int32_t *restrict first, int32_t *restrict last)
{
    int32_t longest = 0;
    for (int32_t j = 1; j < n; j++) {
        const float far_end = r[j] * bins_per_m, near_end = (r[j] - lit[j] * (r[j] - r[j - 1])) * bins_per_m;
        const float from = near_end < far_end ? near_end : far_end, to = near_end < far_end ? far_end : near_end;
        const int32_t from_bin = (int32_t)(from < n_bins ? from : n_bins), to_bin = (int32_t)(to < n_bins ? to : n_bins);
        const int32_t span = to_bin - from_bin, inside = span > 1 ? span - 1 : 0;
        const float sent = low[j], length = span > 0 ? to - from : 1.0f, density = sent / length;
        const float past = (to - (float)to_bin) * density, end_share = span > 0 ? past : 0.0f;
        first[j] = from_bin;
        last[j] = to_bin;
        inner[j] = density;
        high[j] = end_share;
        low[j] = (sent - end_share) - (float)inside * density;
        longest = span > longest ? span : longest;
    }
    return longest;
}

/* elevation, texture, seabed: (n_slots, NODES, NODES). slots: (n_patch_rows, n_patch_columns). lines: (n_lines, LINE_WIDTH), places in cells
 * from node (0, 0) of the first patch, which lies at origin_*. tables: (n_materials, TABLE). beam: (TABLE). scratch: 14 rows of n_nodes;
 * row: two of n_bins + 1. energy: (n_pings, n_bins + 1), added to. lit, owner: (n_lines, n_nodes) or NULL.
 */
void auv_mcm_render_lines(int64_t n_lines, int64_t n_nodes, int64_t n_bins, double cell_m, double bins_per_m, double origin_north,
                          double origin_east, int64_t n_patch_columns, const int32_t *restrict slots, const float *restrict elevation,
                          const float *restrict texture_pool, const uint8_t *restrict seabed, const double *restrict lines, int64_t n_bodies,
                          const double *restrict bodies, const double *restrict planes, const float *restrict tables,
                          const float *restrict beam, void *restrict scratch, double *restrict row, double *restrict energy,
                          float *restrict lit_out, int16_t *restrict owner_out)
{
    const int32_t n = (int32_t)n_nodes;
    float *f = (float *)scratch;
    int32_t *i = (int32_t *)(f + 10 * n_nodes);
    const buffers b = {f,         f + n,     f + 2 * n, f + 3 * n, f + 4 * n, f + 5 * n, f + 6 * n,
                       f + 7 * n, f + 8 * n, f + 9 * n, i,         i + n,     i + 2 * n, i + 3 * n};
    double *restrict starts = row, *restrict ends = row + n_bins + 1;

    for (int64_t l = 0; l < n_lines; l++) {
        const double *restrict line = lines + l * LINE_WIDTH;
        const double step_cells = sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
        const float dy = (float)(step_cells * cell_m), per_dy = (float)(1.0 / (step_cells * cell_m));
        const float ahead_north = (float)(-line[L_STEP_EAST] / (step_cells * cell_m));
        const float ahead_east = (float)(line[L_STEP_NORTH] / (step_cells * cell_m));

        place_nodes(n, line[L_NORTH], line[L_EAST], line[L_STEP_NORTH], line[L_STEP_EAST], b.first, b.last, b.low, b.high);
        for (int32_t j = 0; j < n; j++) {
            const int32_t slot = slots[(int64_t)(b.first[j] >> PATCH_SHIFT) * n_patch_columns + (b.last[j] >> PATCH_SHIFT)];
            const int64_t base = (int64_t)slot * (NODES * NODES) + (b.first[j] & PATCH_MASK) * NODES + (b.last[j] & PATCH_MASK);
            const float *e = elevation + base;
            const float part_north = b.low[j], part_east = b.high[j];
            const float south = e[1] - e[0], north = e[NODES + 1] - e[NODES];
            const float at_south = e[0] + part_east * south, rise = (e[NODES] + part_east * north) - at_south;
            const int64_t nearest = base + (part_north >= 0.5f ? NODES : 0) + (part_east >= 0.5f ? 1 : 0);
            b.z[j] = at_south + part_north * rise;
            b.slope[j] = rise * ahead_north + (south + part_north * (north - south)) * ahead_east;
            b.texture[j] = texture_pool[nearest];
            b.material[j] = seabed[nearest];
            b.owner[j] = -1;
        }
        if (n_bodies > 0) {
            raise_bodies(line, n, cell_m, origin_north, origin_east, n_bodies, bodies, planes, b.z, b.slope, b.texture, b.material, b.owner);
            turn_walls(line, n, cell_m, origin_north, origin_east, bodies, planes, b.z, b.slope, b.texture, b.material, b.owner);
        }
        look_down(n, dy, (float)line[L_ELEVATION], (float)line[L_SLANT], b.z, b.depth, b.r, b.t);
        light(n, b.t, b.lit);
        face(n, dy, per_dy, (float)line[L_AXIS_COS], (float)line[L_AXIS_SIN], (float)line[L_WEIGHT], b.z, b.slope, b.depth, b.r, b.lit,
             b.material, b.first, b.last, b.low);
        for (int32_t j = 1; j < n; j++)
            b.low[j] *= tables[b.first[j]] * beam[b.last[j]] * b.texture[j];
        const int32_t longest = share(n, (float)bins_per_m, (float)n_bins, b.r, b.lit, b.low, b.high, b.inner, b.first, b.last);

        for (int64_t bin = 0; bin < 2 * (n_bins + 1); bin++)
            row[bin] = 0.0;
        for (int32_t j = 1; j < n; j++) {
            starts[b.first[j]] += (double)b.low[j];
            ends[b.last[j]] += (double)b.high[j];
        }
        for (int32_t j = 1; longest > 1 && j < n; j++)
            for (int32_t bin = b.first[j] + 1; bin < b.last[j]; bin++)
                starts[bin] += (double)b.inner[j];
        double *restrict ping = energy + (int64_t)line[L_PING] * (n_bins + 1);
        for (int64_t bin = 0; bin <= n_bins; bin++)
            ping[bin] += starts[bin] + ends[bin];
        for (int32_t j = 0; lit_out && j < n; j++)
            lit_out[l * n_nodes + j] = b.lit[j];
        for (int32_t j = 0; owner_out && j < n; j++)
            owner_out[l * n_nodes + j] = (int16_t)b.owner[j];
    }
}
