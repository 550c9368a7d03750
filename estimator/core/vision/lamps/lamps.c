/* Find and measure a pad by its lamps in one frame, with the confidence that these lights are its lamps.
 *
 * Confidence: how many poses would explain as many spots if lights lay anywhere (number of false alarms, Desolneux, Moisan and Morel,
 * Meaningful alignments, IJCV 40(1), 2000), and how many lamps in view do not shine. */

#include "vision/lamps/lamps.h"

#include <math.h>
#include <string.h>

#include "base/rotation.h"
#include "vision/tracker.h"

enum { CHANNELS = 3 };
/* Work of a pixel in which something bright is looked for, and of a lamp in a pair of spots that is tried. */
enum { PIXEL_WORK = 7, LAMP_WORK = 24 };
/* At most this many of the brightest spots are tried in a shift of an expected pose. */
enum { SHIFTED = 18 };
/* Reach of a lamp's spot about a searched pose, and about a fitted one, px. */
static const double SEARCHED_PX = 3.0, FITTED_PX = 0.8;
static const double MARGIN = 0.25; /* Margin of the part of a frame about the expected lamps, of their extent. */
static const double MARGIN_PX = 24.0; /* The same, px, besides. */
/* Share of the frame from which such a part is taken as the whole, whose spots serve for a search, too. */
static const double MOST_OF_FRAME = 0.5;
/* A deck's and an attitude's errors of tilt, rad: what they add to the first reach, as a part of the pattern's radius in the frame. */
static const double TILTED = 0.04;
/* Distances of spots from their lamps within which chance neighbours are counted, px. */
enum { DISTANCES = 6 };
static const double WITHIN_PX[DISTANCES] = {0.1, 0.25, 0.4, 0.6, 0.9, 1.3};
/* Least number of spots that are lamps, and least part of those that the lamps in view would make. */
enum { LEAST_SEARCHED = 4, LEAST_TRACKED = 3 };
static const double LEAST_SHARE = 0.6; /* That part. */
/* Number of different poses about an expected one. */
static const double EXPECTED_TESTS = 20.0;
/* Logarithm of the number of false alarms at which lights are as likely the pad's as not: one frame in a hundred. */
static const double EVEN_LOG10 = -2.0;
/* Weight against the pad of a light among the lamps that is none of them, and of a lamp in view that does not shine. */
static const double OUTLIER_LOG10 = 0.7, MISSING_LOG10 = 0.5;
static const double OFF_CENTRE_SIGMAS = 3.0; /* Standard deviations by which the middle spot may be off. */
static const double OFF_CENTRE_LOG10 = 1.0; /* Weight against the pad of each further one. */
static const double LEAST_LOG10 = -12.0; /* Least odds. */
static const double MOST_LOG10 = 12.0; /* Largest odds. */
static const double MOST_CHANCE = 0.9; /* Largest chance of a test. */
static const double LEAST_TAIL = 1e-300; /* Least probability that a logarithm is taken of. */
/* Confidence below which lights are no sighting at all. */
static const double LEAST_CONFIDENCE = 0.01;
static const double ANSWERS_APART = 0.1; /* Part of the range by which two answers differ: less than a lamp's own step around the pad. */
static const double TURNED_RAD = 0.2; /* Angle by which they do, rad. */

/* Per-frame constants. */
typedef struct {
    const dl_lens *camera;
    const double *t_body_cam;
    const dl_lamp_pattern *pad;
    const dl_tilt_prior *prior;
    lamp_spots spots;
} dark_frame;

/* A pose of the pad, the spots that its lamps are, and how likely these are its lamps. */
typedef struct {
    lamp_fit fit;
    lamp_assignment of;
    double log10_odds;
} explained_lamps;

int64_t lamps_room(const dl_lens *camera)
{
    const int64_t bright = bright_room(camera->width, camera->height), guesses = guess_room();
    return bright > guesses ? bright : guesses;
}

/* The logarithm of the probability that of n independent events of probability p at least k happen. */
static double log10_tail(int n, int k, double p)
{
    double tail = 0.0, choices = 1.0;
    if (k <= 0) {
        return 0.0;
    }
    for (int i = 0; i <= n; i++) {
        if (i >= k) {
            tail += choices * pow(p, i) * pow(1.0 - p, n - i);
        }
        choices *= (double)(n - i) / (i + 1);
    }
    return log10(fmax(tail, LEAST_TAIL));
}

/* The probability that one of the spots about the pad lies this near to a place by chance. */
static double chance(const lamp_assignment *of, double within_px)
{
    const double spots = of->groups + of->outliers;
    return fmin(MOST_CHANCE, spots * LAMPS_PI * within_px * within_px / of->area_px2);
}

/* The logarithm of the odds that these spots are the pad's lamps and no other lights. Two spots give a similarity; a third one lies
 * within reach of a tilt that is not known. */
static double log10_odds(const dark_frame *f, const lamp_assignment *of, const lamp_fit *fit, double tests)
{
    const int n = of->expected > of->groups ? of->expected : of->groups;
    const double tilt_px = TILTED * fit->extent_px * fit->extent_px / f->camera->fx;
    double alarms = INFINITY;
    for (int k = 0; k < DISTANCES; k++) {
        int within = 0;
        for (int g = 0; g < of->groups; g++) {
            within += fit->off_px[g] <= WITHIN_PX[k];
        }
        const double third = within > 2 ? log10((n - 2) * chance(of, WITHIN_PX[k] + tilt_px)) : 0.0;
        alarms = fmin(alarms, fmin(0.0, third) + log10_tail(n - 3, within - 3, chance(of, WITHIN_PX[k])));
    }
    alarms += log10(tests * DISTANCES) + OUTLIER_LOG10 * of->outliers + MISSING_LOG10 * (n - of->groups);
    alarms += OFF_CENTRE_LOG10 * fmax(0.0, fit->middle_sigmas - OFF_CENTRE_SIGMAS);
    return fmax(LEAST_LOG10, EVEN_LOG10 - alarms);
}

static double range_of(const dl_pad_pose *pose)
{
    return sqrt(dot(pose->t, pose->t));
}

/* Reach of a lamp's spot about a pose that is not fitted, px: by the radius of the pattern about the pad's centre. */
static double first_reach(const dark_frame *f, const dl_pad_pose *pose)
{
    double reach = 0.0;
    for (int k = 0; k < (int)f->pad->lamps; k++) {
        reach = fmax(reach, hypot(f->pad->x_m[k], f->pad->y_m[k]));
    }
    return SEARCHED_PX + TILTED * f->camera->fx * reach / range_of(pose);
}

/* Fit the pose from a start; 0 if too few spots are lamps. */
static int explain(const dark_frame *f, const dl_pad_pose *start, double tests, int least, explained_lamps *out)
{
    const double reaches[] = {first_reach(f, start), SEARCHED_PX, FITTED_PX};
    dl_pad_pose pose = *start;
    for (int k = 0; k < 3; k++) {
        assign_lamps(f->camera, f->pad, &f->spots, &pose, reaches[k], &out->of);
        if (out->of.groups < least || out->of.groups < LEAST_SHARE * out->of.expected ||
            !fit_lamps(f->camera, f->pad, f->prior, &f->spots, &out->of, &pose, &out->fit)) {
            return 0;
        }
        pose = out->fit.pose;
    }
    out->log10_odds = log10_odds(f, &out->of, &out->fit, tests);
    return isfinite(out->log10_odds) != 0;
}

/* Whether two poses are two answers. */
static int differ(const dl_pad_pose *a, const dl_pad_pose *b)
{
    double turn[9];
    const double off[3] = {a->t[0] - b->t[0], a->t[1] - b->t[1], a->t[2] - b->t[2]};
    product_by_transposed(a->R, b->R, turn);
    return sqrt(dot(off, off)) > ANSWERS_APART * range_of(b) || 0.5 * (turn[0] + turn[4] + turn[8] - 1.0) < cos(TURNED_RAD);
}

/* How sure the best answer is: what explains the frame nearly as well in another place or heading is as likely the pad. */
static double confidence_of(int n, const explained_lamps *found, int best)
{
    double odds = 1.0;
    for (int k = 0; k < n; k++) {
        if (k != best && differ(&found[k].fit.pose, &found[best].fit.pose)) {
            odds += pow(10.0, found[k].log10_odds - found[best].log10_odds);
        }
    }
    return 1.0 / ((1.0 + pow(10.0, -fmin(MOST_LOG10, found[best].log10_odds))) * odds);
}

static int all_finite(const double *values, int n)
{
    int finite = 1;
    for (int i = 0; i < n; i++) {
        finite &= isfinite(values[i]) != 0;
    }
    return finite;
}

/* Write the surest of the answers; 0 if none is good enough. */
static int write_surest(const dark_frame *f, int n, const explained_lamps *found, dl_found_lamps *out)
{
    int best = 0;
    for (int k = 1; k < n; k++) {
        best = found[k].log10_odds > found[best].log10_odds ? k : best;
    }
    if (n == 0 || !((out->confidence = confidence_of(n, found, best)) >= LEAST_CONFIDENCE)) {
        return 0;
    }
    out->pose = found[best].fit.pose;
    out->log10_odds = found[best].log10_odds;
    memcpy(out->cov, found[best].fit.cov, sizeof out->cov);
    dl_sighting_in_level(f->camera, f->t_body_cam, f->prior, &out->pose, out->cov, &out->seen);
    if (!all_finite(out->seen.d, (int)(sizeof out->seen / sizeof(double)))) {
        return 0;
    }
    out->lit = 0;
    for (int s = 0; s < f->spots.n; s++) {
        int is_lamp = 0;
        for (int k = 0; k < (int)f->pad->lamps; k++) {
            is_lamp |= found[best].of.spot[k] == s;
        }
        if (is_lamp) {
            memcpy(out->uv_px + 2 * out->lit++, f->spots.spot[s].uv, sizeof f->spots.spot[s].uv);
        }
    }
    return 1;
}

/* Find the spots of a part of the frame; 0, and none, if it has more than a dark deck. */
static int find_spots(dl_tracker *t, const uint8_t *frame, const int at[4], dark_frame *f)
{
    const int stride = CHANNELS * (int)f->camera->width;
    const lit_part part = {frame + (int64_t)at[1] * stride + CHANNELS * at[0], t->lamp_light, stride, at[0], at[1], at[2] - at[0],
                           at[3] - at[1]};
    bright_part bright;
    f->spots.n = 0;
    count_work(t, (int64_t)part.width * part.height, PIXEL_WORK);
    if (!bright_places(&part, (uint32_t *)(void *)t->scratch, &bright)) {
        return 0;
    }
    spots_of(&bright, &part, &f->spots);
    return 1;
}

/* Find the part of a frame that holds the expected lamps and the lights that count against them: left, top, right and low edge. Return 0
 * if hardly any of it is in the frame. */
static int part_about(const dl_lens *camera, const dl_lamp_pattern *pad, const dl_expected_lamps *at, int part[4])
{
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY}, p[3], uv[2];
    const double most[2] = {(double)camera->width, (double)camera->height};
    for (int k = 0; k < (int)pad->lamps; k++) {
        pad_point(&at->pose, pad->x_m[k], pad->y_m[k], p);
        camera_project(camera, p, uv);
        if (!isfinite(uv[0]) || !isfinite(uv[1])) {
            return 0;
        }
        for (int i = 0; i < 2; i++) {
            low[i] = fmin(low[i], uv[i]), high[i] = fmax(high[i], uv[i]);
        }
    }
    const double margin = at->reach_px + MARGIN_PX + MARGIN * hypot(high[0] - low[0], high[1] - low[1]);
    for (int i = 0; i < 2; i++) {
        const double first = fmax(0.0, floor(low[i] - margin)), last = fmin(most[i], ceil(high[i] + margin));
        if (!(last - first >= MARGIN_PX)) {
            return 0;
        }
        part[i] = (int)first, part[2 + i] = (int)last;
    }
    return 1;
}

/* Count the spots near lamps that are shifted in the frame; a spot counts as 1 at its lamp, and less the farther it is. */
static double near_spots(const lamp_spots *spots, int n, const double uv[DL_LAMPS_MAX][2], double du, double dv, double within_px)
{
    double sum = 0.0;
    for (int k = 0; k < n; k++) {
        double least2 = within_px * within_px;
        for (int s = 0; s < spots->n && s < SHIFTED; s++) {
            const double u = uv[k][0] + du - spots->spot[s].uv[0], v = uv[k][1] + dv - spots->spot[s].uv[1];
            least2 = fmin(least2, u * u + v * v);
        }
        sum += 1.0 - least2 / (within_px * within_px);
    }
    return sum;
}

/* Shift an expected pose so that its lamps lie near the most spots: each shift within reach that puts a lamp on a spot is tried. */
static void shift(const dark_frame *f, double reach_px, double within_px, dl_pad_pose *pose)
{
    double uv[DL_LAMPS_MAX][2], best = 0.0, to[2] = {0.0, 0.0};
    const int n = (int)f->pad->lamps;
    for (int k = 0; k < n; k++) {
        double p[3];
        pad_point(pose, f->pad->x_m[k], f->pad->y_m[k], p);
        camera_project(f->camera, p, uv[k]);
    }
    for (int k = 0; k < n; k++) {
        for (int s = 0; s < f->spots.n && s < SHIFTED; s++) {
            const double du = f->spots.spot[s].uv[0] - uv[k][0], dv = f->spots.spot[s].uv[1] - uv[k][1];
            const double sum = du * du + dv * dv <= reach_px * reach_px ? near_spots(&f->spots, n, uv, du, dv, within_px) : 0.0;
            if (sum > best) {
                best = sum, to[0] = du, to[1] = dv;
            }
        }
    }
    pose->t[0] += to[0] * pose->t[2] / f->camera->fx, pose->t[1] += to[1] * pose->t[2] / f->camera->fy;
}

/* Look where the pad is expected; returns the number of answers, none if these lights are hardly the pad's. */
static int find_expected(dark_frame *f, const dl_expected_lamps *at, explained_lamps *out)
{
    dl_pad_pose pose = at->pose;
    shift(f, at->reach_px, first_reach(f, &pose), &pose);
    return explain(f, &pose, EXPECTED_TESTS, LEAST_TRACKED, out) && out->log10_odds >= 0.0;
}

/* Search the spots of the whole frame; returns the number of answers. */
static int find_anywhere(dl_tracker *t, const dark_frame *f, explained_lamps found[LAMP_GUESSES])
{
    dl_pad_pose guesses[LAMP_GUESSES];
    const int tried = guess_lamps(f->camera, f->pad, f->prior, &f->spots, (uint32_t *)(void *)t->scratch, guesses);
    const double tests = guesses_tried(f->pad, &f->spots);
    count_work(t, (int64_t)tests * f->pad->lamps, LAMP_WORK);
    int n = 0;
    for (int k = 0; k < tried; k++) {
        int is_new = 1;
        for (int i = 0; i < n; i++) {
            is_new &= differ(&guesses[k], &found[i].fit.pose);
        }
        n += is_new && explain(f, &guesses[k], tests, LEAST_SEARCHED, &found[n]);
    }
    return n;
}

/* Whether a pattern's numbers are some that there can be. */
static int is_pattern(const dl_lamp_pattern *pad)
{
    if (pad->lamps < 0 || pad->lamps > DL_LAMPS_MAX || pad->pairs < 0 || pad->pairs > DL_LAMP_PAIRS_MAX) {
        return 0;
    }
    for (int k = 0; k < 2 * (int)pad->pairs; k++) {
        if (pad->pair[k] < 0 || pad->pair[k] >= pad->lamps) {
            return 0;
        }
    }
    return 1;
}

int32_t dl_find_lamps(dl_tracker *t, const dl_image *image, const dl_lamp_pattern *pad, const dl_tilt_prior *prior, const dl_expected_lamps *at,
                      dl_found_lamps *out)
{
    const dl_lens *camera = &t->camera.lens;
    const uint8_t *frame = image->px;
    if (!is_image(image, CHANNELS) || image->width != camera->width || image->height != camera->height
        || image->stride != CHANNELS * camera->width || !is_pattern(pad)) {
        return DL_WRONG_SIZE;
    }
    dark_frame f = {.camera = camera, .t_body_cam = t->camera.t_body_cam, .pad = pad, .prior = prior};
    explained_lamps found[LAMP_GUESSES];
    const int whole[4] = {0, 0, (int)camera->width, (int)camera->height};
    int part[4], n = 0, is_whole = 0;
    if (at && part_about(camera, pad, at, part)) {
        is_whole = (part[2] - part[0]) * (double)(part[3] - part[1]) > MOST_OF_FRAME * whole[2] * whole[3];
        n = find_spots(t, frame, is_whole ? whole : part, &f) ? find_expected(&f, at, found) : 0;
    }
    if (n == 0) {
        if (!is_whole && !find_spots(t, frame, whole, &f)) {
            return DL_TOO_BRIGHT;
        }
        n = find_anywhere(t, &f, found);
    }
    return write_surest(&f, n, found, out);
}
