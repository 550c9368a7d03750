/* Looks at pads of many sizes: registration, verification and what is learned. */

static void draw_verification(int kind, dl_pad_verification *of)
{
    of->has_field = kind % 3 > 0, of->has_ring = kind % 5 > 0, of->has_letters = kind % 4 > 0;
    of->has_fiducials = kind % 7 == 6, of->disc_has_colour = kind % 2;
    for (int i = 0; i < 3; i++) {
        of->orange_side[i] = i == kind % 4 ? -1.0 : 1.0, of->orange_place[i] = uniform();
    }
    for (int i = 0; i < DL_FEATURES; i++) {
        of->template_weights[i] = uniform();
    }
    for (int i = 0; i < DL_EVIDENCE; i++) {
        of->searched[i] = uniform(), of->tracked[i] = uniform();
    }
    poisoned(of->orange_side, 6 + DL_FEATURES + 2 * DL_EVIDENCE);
}

static void draw_start(int kind, int alone, dl_start *start)
{
    const dl_start some = {.prior = {.given = !alone || kind % 2, .sigma_deck_rad = 0.03, .cov_tilt = {1e-4, 0.0, 0.0, 1e-4}},
                           .coarse = !alone && kind % 2, .tracked = kind % 3 == 0, .alone = alone,
                           .sigma_tilt_rad = 0.05, .coded_px = alone && kind % 3 == 0 ? 0.12 : 0.0};
    *start = some;
    for (int i = 0; i < 12; i++) {
        start->known.mean[i] = uniform(), start->known.var[i] = 1.0;
    }
    start->known.trust = kind % 3 ? 0.5 : 0.0;
    if (alone && kind % 4 == 3) {
        start->cut[0] = 0.6, start->cut[1] = -0.8, start->cut[2] = 0.1 * uniform();
    }
    poisoned(&start->prior.roll_rad, 7), poisoned(start->known.mean, 25), poisoned(&start->sigma_tilt_rad, 1), poisoned(start->cut, 3);
}

/* Looks at pads of many sizes that register alone, or verify and learn, too. */
static void looks(int count, int alone)
{
    const drawn_maps d = random_maps();
    const double sizes[] = {0.4, 0.1, 3.0};
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i, h = 20 + draw() % 80, w = 20 + draw() % 120;
        dl_lens camera;
        dl_start start;
        dl_pad *pad = random_pad(alone ? sizes[kind % 3] : 0.4, kind);
        double *edges = malloc(5 * EDGE_POINTS * sizeof *edges), *outline = malloc((EDGE_POINTS + 3) / 4 * 2 * sizeof *outline);
        int32_t *edge_of = malloc(2 * EDGE_POINTS * sizeof *edge_of);
        dl_registered_pad *out = calloc(1, sizeof *out);
        some_camera(&camera, h, w, 20.0 + draw() % 100, kind % 5 == 0);
        const double height_m = pad->shape.disc_radius_m * camera.fx / (4.0 + draw() % (alone || kind % 3 ? w / 2 : 4 * w));
        uint8_t *px = picture(&camera, &pad->shape, height_m, kind);
        double *rays = camera.distorted ? rays_of(&camera) : NULL;
        some_edges(&pad->shape, edges, edge_of);
        draw_verification(kind, &pad->verification), draw_start(kind, alone, &start);
        some_start((double *)&start.pose, &camera, height_m, kind % 7 == 0 ? 5.0 : 0.4, kind % 5 == 4);
        dl_tracker *t = tracker_for(&camera, rays, pad, &d, edges, edge_of);
        dl_frame frame = {.level = {{w, h, 3 * w, 3, px}}, .quality = {kind % 5 < 4 ? 0.0 : 0.05, 1.0, 0.0}};
        poisoned(&frame.quality.noise, 3);
        if (dl_look(t, &frame, &start, out, outline, (EDGE_POINTS + 3) / 4) == 1) {
            fold(out->found.pose.t, 3), fold(out->found.pose.R, 9), fold(&out->found.noise_light, 4), fold(out->found.edges[1].contrast_bgr, 7);
            fold(&out->log_odds, 1), fold(out->evidence, DL_EVIDENCE), fold(out->paint.mean, 25), fold(out->seen.d, 3), fold(outline, 200);
        }
        dl_sighting_in_level(&camera, camera.distortion, &start.prior, &out->found.pose, out->found.cov, &out->seen);
        fold(out->seen.d, 3), fold(out->seen.R_level_pad, 9), fold(&out->seen.yaw_rad, 1);
        dl_tracker_free(t);
        void *all[] = {out, pad, px, rays, edges, edge_of, outline};
        for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
            free(all[k]);
        }
    }
    forget(d);
}
