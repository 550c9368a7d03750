/* Calls every entry of the core with random arguments of every size, for the sanitizers to watch, and says what it called and
 * what came of it. Compiled with FUZZED it takes a fuzzer's arguments instead. */

#include <stdio.h>

#include "draws.h"
#include "decklander.h"
#include "decklander_sim.h"

static double found;

/* Fold results into one number, which two machines must agree about; they may differ about what is not finite. */
static void fold(const double *values, int n)
{
    for (int i = 0; i < n; i++) {
        if (isfinite(values[i]) && fabs(values[i]) < 1e12) {
            found += values[i] * (1 + i % 7);
        }
    }
}

static void fold_bytes(const void *values, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        found += ((const uint8_t *)values)[i];
    }
}

/* Exactly as long as it must be, so that the sanitizer sees one step beyond. */
static double *numbers(int n)
{
    double *made = malloc((size_t)n * sizeof(double));
    for (int i = 0; i < n; i++) {
        made[i] = uniform();
    }
    return made;
}

static void parameters(dl_filter_params *o, int surface)
{
    memset(o, 0, sizeof *o);
    o->hold_ns = 60000000;
    o->velocity_is_over = surface;
    o->tick_s = 0.1, o->forget_s = 1.0, o->aiding_period_s = 0.05;
    o->accel_step_m_s2 = 15.0, o->gyro_step_rad_s = 4.0, o->deck_radius_m = 2.0, o->not_measured_var = 1e5;
    o->psd_accel = 1e-3, o->psd_coast = 2.0, o->psd_coast_turn = 0.1;
    o->wave_yaw_rad_s = 1.0, o->sigma_wave_yaw_rate_rad_s = 0.04;
    for (int i = 0; i < DL_KINDS; i++) {
        o->correlation_s[i] = 0.2;
    }
    for (int i = 0; i < DL_ROWS_MAX; i++) {
        o->nis_max[i] = 15.0 + 2.0 * i;
    }
    o->history_ns = 1000000000, o->max_ahead_ns = 50000000, o->leap_ns = 2000000000, o->leap_count = 5;
    o->velocity_scale = 1.0, o->sigma_initial_tilt_rad = 0.05, o->sigma_initial_heading_rad = 0.1, o->sigma_attitude_bias_rad = 0.02;
    for (int i = 0; i < DL_N; i++) {
        o->psd[i] = 1e-4, o->initial_var[i] = 1e-3;
    }
    o->reopen_count = 3, o->reopen_s = 0.1;
    o->min_confidence = 0.05, o->heading_memory_s = 1.0, o->sigma_turn_rate_rad_s = 0.05;
    for (int i = 0; i < 3; i++) {
        o->carrying_psd_accel[i] = o->carrying_psd_drift[i] = o->carrying_psd_tilt[i] = 1e-3;
    }
    for (int g = 0; g < DL_MEMBERS; g++) {
        o->members.w[g] = 0.4 + 0.02 * g;
        o->members.zeta[g] = 0.3;
        o->members.log_zeta[g] = log(0.3);
        o->members.log_prior[g] = g == 0 ? log(0.5) : log(0.5 / (DL_MEMBERS - 1));
        for (int k = 0; k < DL_DIRECTIONS; k++) {
            o->members.sigma[k * DL_MEMBERS + g] = 0.01 * (1 + g % 5);
        }
    }
}

/* A sample of any kind; of wild ones one in ten is beyond anything. */
static void sample(dl_event *e, int64_t t, int wild)
{
    const double size = draw() % 10 == 0 && wild ? 1e3 : 0.1;
    memset(e, 0, sizeof *e);
    e->kind = draw() % DL_SIGHTING;
    e->t = t;
    double *values = e->sample.attitude.R_ned_body;
    for (int i = 0; i < 18; i++) {
        values[i] = size * uniform();
    }
    if (e->kind == DL_ATTITUDE) {
        for (int i = 0; i < 9; i++) {
            values[i] = i % 4 == 0;
        }
    }
    if (e->kind == DL_ATTITUDE || e->kind == DL_VELOCITY) {
        double *cov = e->kind == DL_ATTITUDE ? e->sample.attitude.cov_body : e->sample.velocity.cov_level;
        for (int i = 0; i < 9; i++) {
            cov[i] = i % 4 == 0 ? (draw() % 5 == 0 ? 1e6 : 1e-3) : 0.0;
        }
    }
    poisoned(values, 18);
    if (e->kind == DL_VESSEL) {
        e->sample.vessel.has_velocity = draw() % 2, e->sample.vessel.has_heading = draw() % 2;
        e->sample.vessel.has_turn = draw() % 2;
    } else if (e->kind == DL_MOTION) {
        e->sample.motion.has_tilt = draw() % 2, e->sample.motion.has_heave = draw() % 2;
    }
}

/* A sighting of any kind, of a pad below or of anything. */
static void look(dl_sighting *s)
{
    const int far = draw() % 5 == 0;
    memset(s, 0, sizeof *s);
    s->has_yaw = draw() % 2, s->yaw_ambiguous = draw() % 3 == 0, s->has_pose6 = draw() % 3 == 0;
    s->confidence = 0.5 + 0.5 * uniform();
    s->sigma_s = draw() % 2 ? 0.01 : 0.0;
    s->yaw_rad = draw() % 4 == 0 ? 3.0 : 0.1 * uniform();
    for (int i = 0; i < 3; i++) {
        s->d_level[i] = s->pose_d_level[i] = (far ? 5.0 : 0.05) * uniform() + 2.0 * (i == 2);
        s->pose_R[4 * i] = 1.0;
    }
    for (int i = 0; i < 4; i++) {
        s->cov[5 * i] = 1e-3;
    }
    for (int i = 0; i < 6; i++) {
        s->pose_cov[7 * i] = 1e-3;
    }
    s->by_baseline = draw() % 3 == 0, s->alone = draw() % 2, s->alike_s = draw() % 2 ? 20.0 : 0.0;
    for (int i = 0; i < 3; i++) {
        s->antenna_body[i] = 0.2 * uniform(), s->antenna_vessel[i] = 5.0 * uniform();
    }
    s->cov[0] *= draw() % 50 == 0 ? NAN : 1.0;
    poisoned(s->d_level, 3), poisoned(s->cov, 16), poisoned(s->pose_R, 9), poisoned(s->pose_cov, 36);
}

/* What is known of an instant. */
static void query(dl_filter *f, int64_t t)
{
    enum { HORIZONS = 3 };
    const double horizons_s[HORIZONS] = {0.0, 0.3, 2.5 + 0.1 * (double)(draw() % 60)};
    dl_answer *found = malloc(sizeof *found);
    dl_deck_ahead *ahead = malloc(HORIZONS * sizeof *ahead);
    if (dl_filter_answer(f, t, found)) {
        fold(found->d, 3), fold(found->cov, 49), fold(found->a_body, 3), fold(found->cov_deck, 36);
    }
    if (dl_filter_forecast(f, t, HORIZONS, horizons_s, ahead)) {
        fold(ahead[2].d, 3), fold(ahead[1].cov_d, 9), fold(&ahead[2].rise, 2);
    }
    free(found), free(ahead);
}

/* The same filter, from the bytes that it was saved in, or from a part of them. */
static dl_filter *saved_and_loaded(dl_filter *f, const dl_filter_params *o)
{
    const int64_t bytes = dl_filter_save(f, NULL, 0);
    uint8_t *saved = malloc((size_t)bytes);
    dl_filter_save(f, saved, bytes);
    dl_filter_free(dl_filter_new(o, saved, (int64_t)(draw() % (uint64_t)bytes)));
    dl_filter_free(f);
    f = dl_filter_new(o, saved, bytes);
    free(saved);
    return f;
}

static void views(void)
{
    dl_view *v = calloc(1, sizeof *v);
    for (int64_t i = 0; i < 200; i++) {
        /* Arguments are evaluated in any order. */
        const double roll = 0.1 * uniform(), pitch = 0.1 * uniform(), x = 0.1 * uniform(), y = 0.1 * uniform();
        dl_view_watch(v, i * (5000000 + 10000000 * (i / 100)), (double[3]){x, y, 3.0}, roll, pitch, 0.01, 0.3);
    }
    fold(v->moments, 16), fold(v->together, DL_VIEW_LAGS);
    free(v);
}

static void fly(int surface, int rounds, double poison, int wild)
{
    enum { LENGTH = 60 };
    dl_filter_params *o = malloc(sizeof *o);
    dl_event *events = malloc(LENGTH * sizeof *events);
    dl_outcome *outcomes = malloc(LENGTH * sizeof *outcomes);
    int64_t t = 0;
    parameters(o, surface);
    o->initial_var[DL_POS_REL] *= poison;
    dl_filter *f = dl_filter_new(o, NULL, 0);
    for (int round = 0; round < rounds && f != NULL; round++) {
        for (int i = 0; i < LENGTH; i++) {
            t += draw() % 10 == 0 ? 200000000 : draw() % 5000000;
            sample(&events[i], draw() % 4 == 0 ? t - (int64_t)(draw() % 400000000) : t, wild);
            events[i].received_at = draw() % 500 == 0 ? t + 10000000000 : t;
            if (draw() % 4 == 0) {
                events[i].kind = DL_SIGHTING, events[i].seq = i;
                look(&events[i].sample.sighting);
            }
        }
        dl_filter_put(f, LENGTH, events, outcomes);
        fold(outcomes[LENGTH - 1].innov, 3), fold(&outcomes[LENGTH - 1].nis, 1);
        query(f, t + (int64_t)(draw() % 200000000));
        f = round % 20 == 19 ? saved_and_loaded(f, o) : f;
    }
    dl_filter_free(f);
    free(o), free(events), free(outcomes);
}

#include "exercise_register.h"
#include "exercise_render.h"
#include "exercise_sim.h"
#include "exercise_align.h"
#include "exercise_look.h"
#include "exercise_lamps.h"
#include "exercise_deck.h"
#include "exercise_search.h"
#include "exercise_video.h"
#include "exercise_law.h"

static void fuzz_one(const uint8_t *bytes, size_t size)
{
    begin(bytes, size);
    const int what = fuzzed_byte() % 11;
    if (what == 0) {
        const int surface = draw() % (DL_OVER_EITHER + 1);
        fly(surface, 2, 1.0, 1);
    } else if (what == 1) {
        scenes(1);
    } else if (what == 2) {
        looks(1, 1);
    } else if (what == 3) {
        alignments(1);
    } else if (what == 4) {
        searches(1);
    } else if (what == 5) {
        video(1);
    } else if (what == 6) {
        law(1 + draw() % 20, 1.0);
    } else if (what == 7) {
        looks(1, 0);
    } else if (what == 8) {
        lamps(1);
    } else if (what == 9) {
        decks(1);
    } else {
        sail(draw() % 7, 1 + draw() % 200, 1.0);
    }
}

#ifdef FUZZED
int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    fuzz_one(bytes, size);
    return 0;
}
#else
static void report(const char *functions)
{
    printf("%.17g %s\n", found, functions);
    found = 0.0;
}

/* A fuzzer's input from a file, as the fuzzer would give it. */
static int again(const char *file)
{
    static uint8_t bytes[65536];
    FILE *opened = fopen(file, "rb");
    if (!opened) {
        return 1;
    }
    fuzz_one(bytes, fread(bytes, 1, sizeof bytes, opened));
    return fclose(opened) != 0;
}

int main(int count, char **files)
{
    for (int i = 1; i < count; i++) {
        if (again(files[i])) {
            return 1;
        }
    }
    if (count > 1) {
        return 0;
    }
    printf("%u dl_digest\n", dl_digest());
    for (int surface = DL_OVER_GROUND; surface <= DL_OVER_EITHER; surface++) {
        fly(surface, 200, 1.0, 1);
        fly(surface, 3, NAN, 1);
        fly(surface, 3, -1e300, 1);
    }
    /* After samples beyond anything the last digits of two machines part without end. */
    found = 0.0;
    for (int surface = DL_OVER_GROUND; surface <= DL_OVER_EITHER; surface++) {
        fly(surface, 5, 1.0, 0);
    }
    report("dl_filter_new dl_filter_put dl_filter_answer dl_filter_forecast dl_filter_save dl_filter_free");
    views(), report("dl_view_watch");
    scenes(24);
    report("dl_sim_render_deck dl_sim_render_fill dl_sim_render_smear dl_sim_render_average dl_sim_render_shadow dl_sim_render_sea dl_sim_render_swell "
           "dl_sim_render_water dl_sim_render_pad_kinds dl_sim_render_pad_shares dl_sim_render_pad_lens dl_sim_render_expose "
           "dl_sim_render_mix dl_sim_render_image dl_sim_render_frame dl_sim_render_blur dl_sim_render_meet dl_sim_render_bounds");
    looks(60, 1);
    report("dl_sighting_in_level");
    alignments(40);
    report("dl_tracker_new dl_tracker_free dl_align dl_frame_quality");
    looks(60, 0);
    report("dl_look");
    lamps(120);
    report("dl_find_lamps");
    decks(60);
    report("dl_from_above dl_paint_rest");
    searches(40);
    report("dl_search_circles dl_search_heading dl_search_guesses dl_search_strokes");
    video(40);
    report("dl_uvlc_header dl_uvlc_decode dl_sim_uvlc_encode");
    for (int k = 0; k < 40; k++) {
        law(25, k % 8 == 7 ? NAN : 1.0);
    }
    report("dl_law_axis_step dl_law_step");
    simulator();
    report("dl_sim_vehicle_step dl_sim_vehicle_carry dl_sim_run dl_sim_sensors_read dl_sim_vessel_moved dl_sim_vessel_mounted "
           "dl_sim_training_begin dl_sim_training_step_all");
    return 0;
}
#endif
