/* A vessel's motion on the waves, and that of a point which is fixed to it. */

#include <math.h>
#include <string.h>

#include "decklander_sim.h"
#include "base/rotation.h"
#include "base/wide.h"

enum { MODES = 6, ROLL = 3, PITCH = 4, YAW = 5 };

/* Difference of two steps of time up to which they count as equal, s. */
static const double SAME_STEP_S = 1e-12;

/* exp(-i angle) */
typedef struct {
    double re, im;
} phasor;

static phasor turned_by(double angle)
{
    return (phasor){cos(angle), -sin(angle)};
}

/* Add Re(c exp(-i w t)) of every mode, and its two derivatives. */
static void add_harmonic(const dl_sim_harmonic *h, phasor at, dl_sim_vessel_motion *out)
{
    const double w = h->w_rad_s;
    for (int k = 0; k < MODES; k++) {
        const double re = h->re[k] * at.re - h->im[k] * at.im, im = h->im[k] * at.re + h->re[k] * at.im;
        out->eta[k] += re;
        out->eta_dot[k] += w * im;
        out->eta_ddot[k] -= w * w * re;
    }
}

/* Through equal steps of time the phasor is turned on by one of them, which takes a fifth of the time of its sine and cosine. */
WIDE
static void add_course(const dl_sim_harmonic *h, int32_t n, const double *t_s, dl_sim_vessel_motion *out)
{
    phasor at = {1.0, 0.0}, step = {1.0, 0.0};
    double step_s = NAN;
    for (int32_t i = 0; i < n; i++) {
        if (i > 0 && fabs(t_s[i] - t_s[i - 1] - step_s) < SAME_STEP_S) {
            at = (phasor){at.re * step.re - at.im * step.im, at.re * step.im + at.im * step.re};
        } else {
            at = turned_by(h->w_rad_s * t_s[i]);
            step_s = i + 1 < n ? t_s[i + 1] - t_s[i] : NAN;
            step = turned_by(h->w_rad_s * step_s);
        }
        add_harmonic(h, at, &out[i]);
    }
}

void dl_sim_vessel_moved(int32_t harmonics, const dl_sim_harmonic *h, int32_t n, const double *t_s, dl_sim_vessel_motion *out)
{
    memset(out, 0, (size_t)n * sizeof *out);
    for (int32_t k = 0; k < harmonics; k++) {
        add_course(&h[k], n, t_s, out);
    }
}

/* The angular velocity and acceleration in the vessel's frame.
 * Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., eq. 2.41, and its time derivative. */
static void body_rates(const dl_sim_vessel_motion *m, double w[3], double w_dot[3])
{
    const double cr = cos(m->eta[ROLL]), sr = sin(m->eta[ROLL]), cp = cos(m->eta[PITCH]), sp = sin(m->eta[PITCH]);
    const double r1 = m->eta_dot[ROLL], p1 = m->eta_dot[PITCH], y1 = m->eta_dot[YAW];
    const double r2 = m->eta_ddot[ROLL], p2 = m->eta_ddot[PITCH], y2 = m->eta_ddot[YAW];
    w[0] = r1 - sp * y1;
    w[1] = cr * p1 + cp * sr * y1;
    w[2] = -sr * p1 + cp * cr * y1;
    w_dot[0] = r2 - sp * y2 - cp * p1 * y1;
    w_dot[1] = cr * p2 - sr * r1 * p1 + cp * sr * y2 + (cp * cr * r1 - sp * sr * p1) * y1;
    w_dot[2] = -sr * p2 - cr * r1 * p1 + cp * cr * y2 - (cp * sr * r1 + sp * cr * p1) * y1;
}

static void mount_one(const dl_sim_vessel_origin *origin, const dl_sim_vessel_motion *m, const dl_sim_mount *at, dl_sim_mounted *out)
{
    double w[3], w_dot[3], R[9], arm[3], arm_v[3], arm_a[3], swung[3];
    from_rpy(m->eta[ROLL], m->eta[PITCH], origin->heading_rad + m->eta[YAW], R);
    body_rates(m, w, w_dot);
    cross(w, at->d, arm_v);
    cross(w_dot, at->d, arm_a);
    cross(w, arm_v, swung);
    for (int i = 0; i < 3; i++) {
        arm_a[i] += swung[i];
    }
    rotated(R, at->d, arm);
    rotated(R, arm_v, out->v);
    rotated(R, arm_a, out->a);
    for (int i = 0; i < 3; i++) {
        out->p[i] = origin->p[i] + arm[i];
        out->v[i] += origin->v[i];
        out->a[i] += origin->a[i];
    }
    product(R, at->R, out->R);
    rotated_back(at->R, w, out->w);
}

void dl_sim_vessel_mounted(int32_t n, const dl_sim_vessel_origin *origin, const dl_sim_vessel_motion *m, const dl_sim_mount *at, dl_sim_mounted *out)
{
    for (int32_t i = 0; i < n; i++) {
        mount_one(&origin[i], &m[i], at, &out[i]);
    }
}
