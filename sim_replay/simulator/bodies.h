/* Tops and walls of bodies on the sea floor. bodies.py documents them and holds the numpy twins. */

#ifndef AUV_MCM_BODIES_H
#define AUV_MCM_BODIES_H

#include <math.h>
#include <stdint.h>

#define BODY_WIDTH 20

enum body_field {
    B_KIND,
    B_EAST,
    B_NORTH,
    B_REACH,
    B_SIN,
    B_COS,
    B_BASE,
    B_MATERIAL,
    B_P0,
    B_P1,
    B_P2,
    B_P3,
    B_P4,
    B_PLANE,
    B_SIDES,
    B_TOPS
};
enum body_kind { ELLIPSOID, CYLINDER, CONE, POLYHEDRON, TORUS, SCAR, MOAT };

typedef struct {
    double z, slope_u, slope_v;
    int covered;
} top;

/* Height over the body's base, and slopes, at (u, v) in the body's axes. For SCAR and MOAT z is what the floor is moved
 * by. */
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
    case CYLINDER: { /* radius p0, half length p1, centre at p2, sine p3 >= 0 and cosine p4 of the tilt: +u end raised
                      */
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
            const double end = along < 0.19 ? along / 0.19 : 1.0, ramp = along < 0.19 ? -2.0 * s / (0.19 * p0) : 0.0;
            const double shape = across * across * (1.0 - 6.0 * t * t);
            const double steep = -4.0 * t * across * (1.0 - 6.0 * t * t) - 12.0 * t * across * across;
            out = (top){-p2 * end * shape, -p2 * ramp * shape, -p2 * end * steep / p1, 1};
        }
        break;
    }
    case MOAT: { /* semi-axes p0, p1 of the ring, depth p2, half width p3 in parts of the axes */
        const double s = u / p0, t = v / p1, across = sqrt(s * s + t * t), w = (across - 1.0) / p3,
                     inside = 1.0 - w * w;
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
static inline void body_wall(const double *restrict b, const double *restrict planes, double u, double v,
                             double *normal_u, double *normal_v)
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

#endif
