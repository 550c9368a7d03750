/* Evidence for and against a registration being the pad, and the log-odds that a linear model gives it. */

#include <math.h>

#include "vision/align/align.h"
#include "vision/look/look.h"

/* Kinds of edges, and channels. */
enum { DISC = 0, RING = 1, ARROW = 2, H = 3, UPPER = 4, CHANNELS = 3 };

static const double INLIERS_SEEN = 0.5; /* Share of its edges that agree from which a kind of edge is seen. */
/* Factor on the visible fraction: a kind of edge counts as fully in view from a fifth on. */
static const double TELLING_SNR = 5.0;
static const double RING_GAIN_LOW = 1.6; /* Gain of the better half of a ring up to which it does not count as visible. */
static const double RING_GAIN_HIGH = 2.2; /* Gain from which it does. */
static const double HALF_A_RING = 0.4; /* What remains of the missing ring if a quarter of it agrees. */
/* Contrast of the disc to its surroundings over the H's to the disc: 0.15 on a grey deck, less on a dark one. */
static const double PLAIN_DISC = 0.1;
/* Contrast of a disc without colour over its deviation up to which it counts as none, and from which as one. */
static const double SNR_GREY_HIDDEN = 10.0, SNR_GREY_SHOWN = 20.0;
/* Contrast of the H over the ring's: 1 to 2.4 on pads in nearly all lights. Glare on green that resembles an H has a tenth of it,
 * or four times as much. */
static const double H_OVER_RING_LOW = 0.6, H_OVER_RING_HIGH = 3.0;
/* Share of an H that is in view from which it would show. */
static const double H_IN_VIEW = 0.02;
/* Share of a nearby ring that is in view, up to which it says nothing about the H. */
static const double RING_IN_VIEW = 0.02;
/* Share of a nearby H that is in view, up to which it is only a corner, and from which it is not. Of 490 right registrations
 * from 0.2 m on two showed less than 0.28 of an H. */
static const double CORNER = 0.2, NO_CORNER = 0.3;
/* Share of a distant pad's pixels that agree with the drawing, up to which it surely disagrees, and from which it does not. */
static const double DISAGREES = 0.45, AGREES = 0.485;
/* Share of agreeing pixels in these two cases, for light that hardly follows the drawing. A fit that does not settle leaves half of them. */
static const double HALF_DISAGREES = 0.52, MOST_AGREE = 0.7;
/* Share of a distant pad's pixels that agree with the drawing, up to which half of them disagree, and from which fewer do. */
static const double HALF_AGREES = 0.5, MORE_AGREES = 0.52;
/* Score of the template up to which the light hardly follows the drawing, and from which it does. */
static const double HARDLY_FOLLOWS = 0.0, FOLLOWS = 1.0;
/* Contrast of such a disc over its deviation up to which it does not outweigh that rejection, and from which it does. */
static const double SNR_DULL = 20.5, SNR_CLEAR = 30.0;
/* The logarithm of the H's least contrast in any channel, up to which it surely is not brighter than the disc, and from which it
 * is. In haze the least of right registrations that are sure is -1.9. */
static const double NOT_BRIGHTER = -2.6, BRIGHTER = -2.1;
/* Share of an H's edges that agree, where nothing else shows, up to which it surely is another H, and from which it is not. */
static const double OTHER_H = 0.8, THIS_H = 0.95;
/* Share of lettering of a second paint that is in view from which some of it would show: a cover leaves a part. */
static const double UPPER_IN_VIEW = 0.5;
/* Unexplained displacement of the edges, rms, px, up to which they are in place, and from which they are not. */
static const double IN_PLACE_PX = 0.6, ASTRAY_PX = 0.9;
static const double LEAST_COMPARED_CONTRAST = 1e-3; /* Least contrast that another is compared with. */
static const double NO_CONTRAST = 1e-6; /* Contrast of an edge that shows none. */

/* 0..1: 1 at `yes`, 0 at `no`, and linear between. */
static double ramp(double yes, double no, double value)
{
    return clipped((value - no) / (yes - no), 0.0, 1.0);
}

static int is_seen(const dl_edge_support *edge)
{
    return edge->snr > SNR_SEEN && edge->inliers > INLIERS_SEEN && edge->in_view > 0.0 && edge->likeness > LIKENESS_SEEN;
}

static double contrast(const dl_edge_support *edge)
{
    const double *bgr = edge->contrast_bgr;
    return sqrt(bgr[0] * bgr[0] + bgr[1] * bgr[1] + bgr[2] * bgr[2]);
}

/* Whether the H does not show, nor the arrowhead, which no other helipad has. */
static int no_h_shows(const dl_registration *found)
{
    return !is_seen(&found->edges[H]) && !is_seen(&found->edges[ARROW]);
}

/* By channel the distance of the ring's light from its place between the disc's (0) and the H's (1), which no light changes. */
static void orange_off(const dl_pad_verification *judge, const dl_registration *found, double off[CHANNELS])
{
    const double *ring = found->edges[RING].contrast_bgr, *h = found->edges[H].contrast_bgr;
    const double least = 0.1 * fmax(fmax(fabs(h[0]), fabs(h[1])), fmax(fabs(h[2]), LEAST_COMPARED_CONTRAST));
    for (int c = 0; c < CHANNELS; c++) {
        const double side = judge->orange_side[c];
        off[c] = fabs(side * ring[c] / fmax(side * h[c], least) - judge->orange_place[c]);
    }
}

/* How surely there is no ring: less so if enough of it is in view and half of that is clear, because the rest may be covered. */
static double no_ring(const dl_registration *found, const dl_aligned_pad *aligned)
{
    const dl_edge_support *ring = &found->edges[RING];
    if (is_seen(ring)) {
        return 0.0;
    }
    if (found->dense) {
        return 1.0;
    }
    const int half = ring->in_view > 0.25 && ring->snr > 2.0 * SNR_SEEN && ring->likeness > 0.8 && ring->inliers > 0.25;
    return (half ? HALF_A_RING : 1.0) * ramp(RING_GAIN_LOW, RING_GAIN_HIGH, aligned->features[FEATURE_RING]);
}

/* How surely the disc's contrast is less than a third of that of its kind of paint. A grey disc may be as bright as any deck: there a
 * faint disc is a disc as long as its edge shows. */
static double no_disc(const dl_pad_verification *judge, const dl_registration *found)
{
    const dl_edge_support *disc = &found->edges[DISC];
    const double h = fmax(contrast(&found->edges[H]), LEAST_COMPARED_CONTRAST);
    const double less = clipped(2.0 * (log(PLAIN_DISC * h / fmax(contrast(disc), NO_CONTRAST)) - 0.5), 0.0, 1.0);
    return judge->disc_has_colour ? less : less * ramp(SNR_GREY_HIDDEN, SNR_GREY_SHOWN, disc->snr);
}

/* How surely the H shows less or more than the ring beside it implies. */
static double h_contrast_odd(const dl_registration *found)
{
    const double ring = fmax(contrast(&found->edges[RING]), NO_CONTRAST), h = fmax(contrast(&found->edges[H]), NO_CONTRAST);
    return clipped(2.0 * fmax(log(H_OVER_RING_LOW * ring / h), log(h / (H_OVER_RING_HIGH * ring))), 0.0, 1.0);
}

/* How surely the H's paint is not brighter than the disc's in some channel, although the pad's is in all. */
static double not_brighter(const dl_pad_verification *judge, const dl_aligned_pad *aligned)
{
    for (int c = 0; c < CHANNELS; c++) {
        if (judge->orange_side[c] < 0.0) {
            return 0.0;
        }
    }
    return ramp(NOT_BRIGHTER, BRIGHTER, aligned->features[FEATURE_WHITE]);
}

/* Evidence for a pad whose disc has few pixels, where contrasts say more than shapes. */
static void from_afar(const dl_pad_verification *judge, const dl_registration *found, const dl_aligned_pad *aligned, double template_score,
                      double out[DL_EVIDENCE])
{
    const int has_both = judge->has_ring && judge->has_letters, shown = is_seen(&found->edges[RING]) && is_seen(&found->edges[H]);
    out[EVIDENCE_DENSE] = 1.0;
    out[EVIDENCE_DENSE_INLIERS] = found->inliers;
    out[EVIDENCE_DENSE_TEMPLATE_SCORE] = template_score;
    out[EVIDENCE_DISAGREES] = ramp(DISAGREES, AGREES, found->inliers);
    out[EVIDENCE_HALF_DISAGREES] = ramp(HALF_DISAGREES, MOST_AGREE, found->inliers) *
                                   ramp(HARDLY_FOLLOWS, FOLLOWS, template_score) *
                                   ramp(SNR_DULL, SNR_CLEAR, found->edges[DISC].snr);
    if (judge->has_field) {
        out[EVIDENCE_DENSE_DISC] = clipped(0.5 * log(fmax(found->edges[DISC].snr, 1e-3) / SNR_SEEN), -1.0, 1.0);
    }
    if (judge->has_field && judge->has_letters) {
        out[EVIDENCE_NO_DISC] = no_disc(judge, found);
    }
    if (judge->has_letters && judge->disc_has_colour) {
        out[EVIDENCE_H_DISAGREES] = ramp(HALF_AGREES, MORE_AGREES, found->inliers) * (1.0 - found->edges[H].inliers);
    }
    if (has_both) {
        double off[CHANNELS];
        orange_off(judge, found, off);
        out[EVIDENCE_DENSE_ORANGE] = -(fmin(1.0, off[0]) + fmin(1.0, off[1]) + fmin(1.0, off[2])) / CHANNELS;
        /* A life raft's dark rim is off by 0.6 in red alone; of 150 right registrations at 8 to 26 m one in ten is off by 0.37. */
        out[EVIDENCE_PAINTED] = shown ? fmax(0.0, 1.0 - 2.0 * fmax(off[0], fmax(off[1], off[2]))) : 0.0;
        out[EVIDENCE_H_CONTRAST_ODD] = h_contrast_odd(found);
        out[EVIDENCE_NOT_BRIGHTER] = not_brighter(judge, aligned);
    }
}

/* Evidence for a pad whose edges are apart. */
static void from_near(const dl_pad_verification *judge, const dl_registration *found, double disc_shown, double out[DL_EVIDENCE])
{
    const dl_edge_support *disc = &found->edges[DISC], *ring = &found->edges[RING], *h = &found->edges[H];
    const int other = is_seen(disc) || (is_seen(ring) && ring->in_view > RING_IN_VIEW) || is_seen(&found->edges[ARROW]);
    out[EVIDENCE_DISC_UNSEEN] = disc->snr < SNR_SEEN ? disc_shown : 0.0;
    out[EVIDENCE_CORNER] = judge->has_letters && is_seen(h) && !is_seen(disc) ? ramp(CORNER, NO_CORNER, h->in_view) : 0.0;
    /* A sheet without a disc may be bent, and an unknown lens displaces large drawings: their support says more. */
    out[EVIDENCE_EDGES_ASTRAY] = judge->has_field ? ramp(ASTRAY_PX, IN_PLACE_PX, found->edge_rms_px) : 0.0;
    out[EVIDENCE_NO_H_IN_VIEW] = judge->has_letters && !judge->has_fiducials && h->in_view <= H_IN_VIEW && no_h_shows(found);
    const dl_edge_support *upper = &found->edges[UPPER];
    const double no_upper = upper->in_view > UPPER_IN_VIEW && upper->snr < SNR_SEEN;
    out[EVIDENCE_H_ASTRAY] = other ? 0.0 : fmax(no_upper, ramp(OTHER_H, THIS_H, h->inliers));
}

void look_evidence(const dl_pad_verification *judge, const double weights[DL_EVIDENCE], const dl_registration *found, const dl_aligned_pad *aligned,
                   double evidence[DL_EVIDENCE], double *log_odds)
{
    const dl_edge_support *edges = found->edges, *h = &edges[H];
    double score = 0.0, in_view[DL_EDGE_KINDS];
    for (int i = 0; i < DL_FEATURES; i++) {
        score += judge->template_weights[i] * aligned->features[i];
    }
    score = clipped(score, -8.0, 8.0);
    for (int k = 0; k < DL_EDGE_KINDS; k++) {
        in_view[k] = fmin(1.0, TELLING_SNR * edges[k].in_view);
    }
    for (int i = 0; i < DL_EVIDENCE; i++) {
        evidence[i] = 0.0;
    }
    evidence[EVIDENCE_ONE] = 1.0;
    evidence[EVIDENCE_TEMPLATE_SCORE] = score;
    evidence[EVIDENCE_INLIERS] = found->inliers;
    evidence[EVIDENCE_DISC_OFF] = -in_view[DISC] * (1.0 - edges[DISC].inliers);
    evidence[EVIDENCE_RING_OFF] = -in_view[RING] * (1.0 - edges[RING].inliers);
    evidence[EVIDENCE_H_OFF] = -in_view[H] * (1.0 - h->inliers);
    evidence[EVIDENCE_RING_UNSEEN] = is_seen(&edges[RING]) ? 0.0 : -in_view[RING];
    evidence[EVIDENCE_H_UNSEEN] = is_seen(h) ? 0.0 : -in_view[H];
    evidence[EVIDENCE_RMS] = -fmin(1.0, found->edge_rms_px);
    evidence[EVIDENCE_VISIBLE] = found->visible;
    evidence[EVIDENCE_NO_RING] = judge->has_ring ? no_ring(found, aligned) : 0.0;
    evidence[EVIDENCE_NO_H] = judge->has_letters && h->in_view > H_IN_VIEW && no_h_shows(found);
    if (found->dense) {
        from_afar(judge, found, aligned, score, evidence);
    } else {
        from_near(judge, found, in_view[DISC], evidence);
    }
    *log_odds = 0.0;
    for (int i = 0; i < DL_EVIDENCE; i++) {
        *log_odds += weights[i] * evidence[i];
    }
}
