/* Echo energy of rays over a height field, one vertical slice per ray. render.py documents the computation and holds
 * the numpy twin, which gives the same bytes: same operations in the same order, no fused multiply-adds, no function of
 * libm but the square root and rounding.
 */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "bodies.h"

/* Raised whenever a signature changes, so that a stale library is refused instead of called wrongly. */
#define AUV_MCM_SIMULATOR_VERSION 2

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

int32_t auv_mcm_simulator_version(void) { return AUV_MCM_SIMULATOR_VERSION; }

enum line_field {
    L_NORTH,
    L_EAST,
    L_STEP_NORTH,
    L_STEP_EAST,
    L_ELEVATION,
    L_SLANT,
    L_AXIS_COS,
    L_AXIS_SIN,
    L_WEIGHT,
    L_PING
};


/* Put the bodies on the profile of one ray. material: first entry of its table. owner: index of the body that a node
 * lies on, -1 for the floor. */
static void raise_bodies(const double *restrict line, int64_t n_nodes, double cell_m, int64_t n_bodies,
                         const double *restrict bodies, const double *restrict planes, float *restrict z,
                         float *restrict q, float *restrict texture, int32_t *restrict material,
                         int32_t *restrict owner)
{
    const double step_m = cell_m *
                          sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
    const double away_north = line[L_STEP_NORTH] * cell_m / step_m, away_east = line[L_STEP_EAST] * cell_m / step_m;
    const double ahead_north = -away_east, ahead_east = away_north; /* a right angle from the ray; its sign is free */
    for (int64_t k = 0; k < n_bodies; k++) {
        const double *b = bodies + k * BODY_WIDTH;
        const double north = line[L_NORTH] * cell_m - b[B_NORTH], east = line[L_EAST] * cell_m - b[B_EAST];
        const double along = -(north * away_north + east * away_east), miss = north * ahead_north + east * ahead_east;
        const double inside = b[B_REACH] * b[B_REACH] - miss * miss;
        if (!(inside > 0.0))
            continue;
        const double half = sqrt(inside);
        const double low = ceil((along - half) / step_m), high = floor((along + half) / step_m);
        if (high < 0.0 || low > (double)(n_nodes - 1))
            continue;
        const int64_t first = low<0.0 ? 0 : (int64_t)low, last = high>(double)(n_nodes - 1) ? n_nodes - 1
                                                                                            : (int64_t)high;
        const double u0 = east * b[B_SIN] + north * b[B_COS], v0 = east * b[B_COS] - north * b[B_SIN];
        const double du = (away_east * b[B_SIN] + away_north * b[B_COS]) * step_m;
        const double dv = (away_east * b[B_COS] - away_north * b[B_SIN]) * step_m;
        const double ahead_u = ahead_east * b[B_SIN] + ahead_north * b[B_COS],
                     ahead_v = ahead_east * b[B_COS] - ahead_north * b[B_SIN];
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
                material[j] = (int32_t)b[B_MATERIAL] * TABLE;
                owner[j] = (int32_t)k;
            }
        }
    }
}

/* A wall stands between two nodes of different owners: it belongs to the higher one, and its slope along the track
 * follows from how it is turned. Facet j lies between nodes j - 1 and j and carries what node j carries, so this may
 * overwrite it. Backwards, because what facet j takes from node j - 1 must not have been overwritten. */
static void turn_walls(const double *restrict line, int64_t n_nodes, double cell_m, const double *restrict bodies,
                       const double *restrict planes, const float *restrict z, float *restrict q,
                       float *restrict texture, int32_t *restrict material, const int32_t *restrict owner)
{
    const double step_m = cell_m *
                          sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
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
        const double north = line[L_NORTH] * cell_m - b[B_NORTH], east = line[L_EAST] * cell_m - b[B_EAST];
        const double e = east + (double)outer * step_m * away_east, n = north + (double)outer * step_m * away_north;
        double normal_u, normal_v;
        body_wall(b, planes, e * b[B_SIN] + n * b[B_COS], e * b[B_COS] - n * b[B_SIN], &normal_u, &normal_v);
        const double towards = normal_u * (away_east * b[B_SIN] + away_north * b[B_COS]) +
                               normal_v * (away_east * b[B_COS] - away_north * b[B_SIN]);
        const double aside = normal_u * (ahead_east * b[B_SIN] + ahead_north * b[B_COS]) +
                             normal_v * (ahead_east * b[B_COS] - ahead_north * b[B_SIN]);
        const double limit = 20.0 * fabs(towards);
        const double bounded = aside > limit ? limit : aside < -limit ? -limit : aside;
        q[j] = towards != 0.0 ? (float)((double)(z[j] - z[j - 1]) / step_m * (bounded / towards)) : 0.0f;
    }
}

/* Where the nodes of a ray lie: patch, index of the south-western of the four corners around and of the nearest one
 * within the patch, and how far to the north and east of the former. first_row, first_column: cell that node 0 lies in;
 * part_*: where in it. */
WIDE static void place(int32_t n, int32_t first_row, int32_t first_column, float first_north, float first_east,
                       float step_north, float step_east, int32_t n_patch_columns, int32_t *restrict patch,
                       int32_t *restrict corner, int32_t *restrict nearest, float *restrict part_north,
                       float *restrict part_east)
{
    for (int32_t j = 0; j < n; j++) {
        const float north = first_north + (float)j * step_north, east = first_east + (float)j * step_east;
        int32_t row = (int32_t)north, column = (int32_t)east;
        row -= (float)row > north;
        column -= (float)column > east;
        const float n_part = north - (float)row, e_part = east - (float)column;
        row += first_row;
        column += first_column;
        const int32_t at = (row & PATCH_MASK) * NODES + (column & PATCH_MASK);
        patch[j] = (row >> PATCH_SHIFT) * n_patch_columns + (column >> PATCH_SHIFT);
        corner[j] = at;
        nearest[j] = at + (int32_t)(n_part + 0.5f) * NODES + (int32_t)(e_part + 0.5f);
        part_north[j] = n_part;
        part_east[j] = e_part;
    }
}

/* Heights at the western and the eastern one of two corners. */
typedef struct {
    float west, east;
} pair;

/* What the patches hold at those places. material: first entry of its table. */
static void fetch(int32_t n, const int32_t *restrict slots, const float *restrict elevation,
                  const float *restrict texture_pool, const uint8_t *restrict seabed, const int32_t *restrict patch,
                  const int32_t *restrict corner, const int32_t *restrict nearest, pair *restrict south,
                  pair *restrict north, float *restrict texture, int32_t *restrict material)
{
    for (int32_t j = 0; j < n;) {
        const int32_t here = patch[j];
        const int64_t base = (int64_t)slots[here] * (NODES * NODES);
        const float *heights = elevation + base, *textures = texture_pool + base;
        const uint8_t *kinds = seabed + base;
        for (; j < n && patch[j] == here; j++) {
            memcpy(&south[j], heights + corner[j], sizeof(pair));
            memcpy(&north[j], heights + corner[j] + NODES, sizeof(pair));
            texture[j] = textures[nearest[j]];
            material[j] = kinds[nearest[j]] * TABLE;
        }
    }
}

/* Height and slope along the track, bilinear. */
WIDE static void blend(int32_t n, float ahead_north, float ahead_east, const pair *restrict south,
                       const pair *restrict north, const float *restrict part_north, const float *restrict part_east,
                       float *restrict z, float *restrict slope)
{
    for (int32_t j = 0; j < n; j++) {
        const float along = south[j].east - south[j].west, far = north[j].east - north[j].west;
        const float low = south[j].west + part_east[j] * along, rise = (north[j].west + part_east[j] * far) - low;
        z[j] = low + part_north[j] * rise;
        slope[j] = rise * ahead_north + (along + part_north[j] * (far - along)) * ahead_east;
    }
}

/* Slant depth and range, and depression as depth over nodes from the sonar. */
WIDE static void look_down(int32_t n, float dy, float sonar_m, float slant, const float *restrict inverse,
                           const float *restrict z, float *restrict depth, float *restrict r, float *restrict t)
{
    for (int32_t j = 0; j < n; j++) {
        const float y = (float)j * dy, below = sonar_m - z[j], slanted = below * slant;
        depth[j] = slanted;
        r[j] = sqrtf(y * y + slanted * slanted);
        t[j] = below * inverse[j];
    }
    t[0] = INFINITY;
}

/* least[j]: of all depressions before j. */
static void find_least(int32_t n, const float *restrict t, float *restrict least)
{
    float lowest = INFINITY;
    for (int32_t j = 0; j < n; j++) {
        least[j] = lowest;
        lowest = t[j] < lowest ? t[j] : lowest;
    }
}

/* Facet j lies between nodes j - 1 and j; facet 0 is none. lit: the share of it that no nearer node hides. entry,
 * beam_entry: of the tables; entry comes in as the first of the material's. upright: depth per slant depth. area: lit,
 * per metre of width, weighed by texture. Its energy is spread evenly over the slant ranges, in bins, that the lit part
 * spans, and bin n_bins takes what lies beyond: first is the bin where that starts, past what share goes into the bin
 * where it ends if it is another, inner what share goes into each between; between counts those. */
WIDE static void face(int32_t n, float dy, float per_dy, float upright, float axis_cos, float axis_sin, float weight,
                      float bins_per_m, float n_bins, const float *restrict z, const float *restrict slope,
                      const float *restrict texture, const float *restrict depth, const float *restrict r,
                      const float *restrict t, const float *restrict least, float *restrict lit,
                      int32_t *restrict entry, int32_t *restrict beam_entry, float *restrict area,
                      int32_t *restrict first, int32_t *restrict between, float *restrict past, float *restrict inner)
{
    const float width = dy * weight;
    for (int32_t j = 1; j < n; j++) {
        const float middle_y = ((float)j - 0.5f) * dy, middle_depth = 0.5f * (depth[j] + depth[j - 1]);
        const float middle_r = 0.5f * (r[j] + r[j - 1]), s = (z[j] - z[j - 1]) * per_dy;
        const float stretch = sqrtf(1.0f + s * s + slope[j] * slope[j]), per = 1.0f / (middle_r * stretch);
        const float sine = (middle_depth * upright + middle_y * s) * per;
        const float off_axis = (middle_depth * axis_cos - middle_y * axis_sin) * (per * stretch);
        const int32_t level = (int32_t)(sine * TABLE), angle = (int32_t)((off_axis + 1.0f) * (0.5f * TABLE));
        const int32_t bounded = level < 0 ? 0 : level > TABLE - 1 ? TABLE - 1 : level;
        const float out = (least[j] - t[j]) * (float)j, hidden = (t[j - 1] - least[j]) * ((float)j - 1.0f);
        const float seen = hidden > 0.0f ? out / (out + hidden) : 1.0f, share = t[j] < least[j] ? seen : 0.0f;
        const float far_end = r[j] * bins_per_m, near_end = (r[j] - share * (r[j] - r[j - 1])) * bins_per_m;
        const float from = near_end < far_end ? near_end : far_end, to = near_end < far_end ? far_end : near_end;
        const int32_t from_bin = (int32_t)(from < n_bins ? from : n_bins),
                      to_bin = (int32_t)(to < n_bins ? to : n_bins);
        const int32_t span = to_bin - from_bin, inside = span > 1 ? span - 1 : 0;
        const float per_bin = 1.0f / (to - from), ending = (to - (float)to_bin) * per_bin;
        lit[j] = share;
        entry[j] += bounded;
        beam_entry[j] = angle < 0 ? 0 : angle > TABLE - 1 ? TABLE - 1 : angle;
        area[j] = sine > 0.0f ? stretch * width * share * texture[j] : 0.0f;
        first[j] = from_bin;
        between[j] = inside;
        past[j] = span > 0 ? ending : 0.0f;
        inner[j] = inside > 0 ? per_bin : 0.0f;
    }
}

/* Energy of one ray in a bin: of facets that start in it, and what those leave to the next. */
typedef struct {
    double own, next;
} bin;

/* Adds each facet's energy to the bins it spans, facets that skip bins last. skipping: room for their numbers; area:
 * theirs become energy.
 */
static void deposit(int32_t n, const float *restrict tables, const float *restrict beam, const int32_t *restrict entry,
                    const int32_t *restrict beam_entry, float *restrict area, const int32_t *restrict first,
                    const int32_t *restrict between, const float *restrict past, const float *restrict inner,
                    int32_t *restrict skipping, bin *restrict bins)
{
    int32_t n_skipping = 0;
    for (int32_t j = 1; j < n; j++) {
        const float energy = area[j] * (tables[entry[j]] * beam[beam_entry[j]]), ending = energy * past[j];
        if (between[j] > 0) {
            area[j] = energy;
            skipping[n_skipping++] = j;
            continue;
        }
        bin *b = bins + first[j];
        b->own += (double)(energy - ending);
        b->next += (double)ending;
    }
    for (int32_t k = 0; k < n_skipping; k++) {
        const int32_t j = skipping[k];
        const float ending = area[j] * past[j], each = area[j] * inner[j];
        bins[first[j]].own += (double)((area[j] - ending) - (float)between[j] * each);
        bins[first[j] + between[j]].next += (double)ending;
    }
    for (int32_t k = 0; k < n_skipping; k++) {
        const int32_t j = skipping[k];
        const float each = area[j] * inner[j];
        for (int32_t i = 1; i <= between[j]; i++)
            bins[first[j] + i].own += (double)each;
    }
}

/* elevation, texture, seabed: (n_slots, NODES, NODES). slots: (n_patch_rows, n_patch_columns), the first of which
 * starts at cell (first_row, first_column). lines: (n_lines, LINE_WIDTH). tables: (n_materials, TABLE). beam: (TABLE).
 * scratch: 22 rows of n_nodes floats; bins: n_bins + 1. energy: (n_pings, n_bins + 1), added to. lit, owner: (n_lines,
 * n_nodes) or NULL.
 */
void auv_mcm_render_lines(int64_t n_lines, int64_t n_nodes, int64_t n_bins, double cell_m, double bins_per_m,
                          int64_t first_row, int64_t first_column, int64_t n_patch_columns,
                          const int32_t *restrict slots, const float *restrict elevation,
                          const float *restrict texture_pool, const uint8_t *restrict seabed,
                          const double *restrict lines, int64_t n_bodies, const double *restrict bodies,
                          const double *restrict planes, const float *restrict tables, const float *restrict beam,
                          float *restrict scratch, bin *restrict bins, double *restrict energy, float *restrict lit_out,
                          int16_t *restrict owner_out)
{
    const int32_t n = (int32_t)n_nodes;
    float *const z = scratch, *const slope = z + n, *const texture = slope + n, *const depth = texture + n,
                 *const r = depth + n;
    float *const t = r + n, *const least = t + n, *const lit = least + n, *const area = lit + n, *const past = area + n;
    float *const inner = past + n, *const inverse = inner + n;
    pair *const south = (pair *)(inverse + n), *const north = south + n;
    int32_t *const material = (int32_t *)(north + n), *const first = material + n, *const between = first + n;
    int32_t *const beam_entry = between + n, *const owner = beam_entry + n, *const skipping = owner + n;

    for (int32_t j = 0; j < n; j++)
        inverse[j] = 1.0f / (float)j;
    for (int64_t l = 0; l < n_lines; l++) {
        const double *restrict line = lines + l * LINE_WIDTH;
        const double step_cells = sqrt(line[L_STEP_NORTH] * line[L_STEP_NORTH] + line[L_STEP_EAST] * line[L_STEP_EAST]);
        const float dy = (float)(step_cells * cell_m), per_dy = (float)(1.0 / (step_cells * cell_m));
        const float ahead_north = (float)(-line[L_STEP_EAST] / (step_cells * cell_m));
        const float ahead_east = (float)(line[L_STEP_NORTH] / (step_cells * cell_m));
        const double row = floor(line[L_NORTH]), column = floor(line[L_EAST]);

        place(n, (int32_t)(row - (double)first_row), (int32_t)(column - (double)first_column),
              (float)(line[L_NORTH] - row), (float)(line[L_EAST] - column), (float)line[L_STEP_NORTH],
              (float)line[L_STEP_EAST], (int32_t)n_patch_columns, first, between, beam_entry, past, inner);
        fetch(n, slots, elevation, texture_pool, seabed, first, between, beam_entry, south, north, texture, material);
        blend(n, ahead_north, ahead_east, south, north, past, inner, z, slope);
        for (int32_t j = 0; (n_bodies > 0 || owner_out) && j < n; j++)
            owner[j] = -1;
        if (n_bodies > 0) {
            raise_bodies(line, n, cell_m, n_bodies, bodies, planes, z, slope, texture, material, owner);
            turn_walls(line, n, cell_m, bodies, planes, z, slope, texture, material, owner);
        }
        look_down(n, dy, (float)line[L_ELEVATION], (float)line[L_SLANT], inverse, z, depth, r, t);
        find_least(n, t, least);
        face(n, dy, per_dy, (float)(1.0 / line[L_SLANT]), (float)line[L_AXIS_COS], (float)line[L_AXIS_SIN],
             (float)line[L_WEIGHT], (float)bins_per_m, (float)n_bins, z, slope, texture, depth, r, t, least, lit,
             material, beam_entry, area, first, between, past, inner);

        for (int64_t b = 0; b <= n_bins; b++)
            bins[b].own = bins[b].next = 0.0;
        deposit(n, tables, beam, material, beam_entry, area, first, between, past, inner, skipping, bins);
        double *restrict ping = energy + (int64_t)line[L_PING] * (n_bins + 1);
        ping[0] += bins[0].own;
        for (int64_t b = 1; b <= n_bins; b++)
            ping[b] += bins[b].own + bins[b - 1].next;
        lit[0] = 0.0f;
        for (int32_t j = 0; lit_out && j < n; j++)
            lit_out[l * n_nodes + j] = lit[j];
        for (int32_t j = 0; owner_out && j < n; j++)
            owner_out[l * n_nodes + j] = (int16_t)owner[j];
    }
}
