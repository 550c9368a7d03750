/* Looks at pads of many sizes: registration, verification and what is learned, with working memory as long as it must be. */

/* What is known of a pad and of its paints, and what is asked. */
typedef struct {
    pad_judge judge;
    pad_paint known;
    look_options how;
    frame_quality quality;
} some_look;

static void draw_look(int kind, some_look *l)
{
    memset(l, 0, sizeof *l);
    l->judge.has_field = kind % 3 > 0, l->judge.has_ring = kind % 5 > 0, l->judge.has_letters = kind % 4 > 0;
    l->judge.has_fiducials = kind % 7 == 6;
    l->judge.disc_has_colour = kind % 2, l->how.coarse = kind % 2, l->how.sigma_tilt_rad = 0.05;
    for (int i = 0; i < 3; i++) {
        l->judge.orange_side[i] = i == kind % 4 ? -1.0 : 1.0, l->judge.orange_place[i] = uniform();
    }
    for (int i = 0; i < FEATURES; i++) {
        l->judge.template_weights[i] = uniform();
    }
    for (int i = 0; i < EVIDENCE; i++) {
        l->judge.weights[i] = uniform();
    }
    for (int i = 0; i < 12; i++) {
        l->known.mean[i] = uniform(), l->known.var[i] = 1.0;
    }
    l->known.trust = kind % 3 ? 0.5 : 0.0;
    l->quality.contrast = 1.0, l->quality.noise = kind % 5 ? 0.0 : 0.05;
    poisoned(l->judge.orange_side, 6 + FEATURES + EVIDENCE), poisoned(&l->how.sigma_tilt_rad, 4);
    poisoned(l->known.mean, 25), poisoned(&l->quality.noise, 3);
}

static void looks(int count)
{
    const drawn_maps d = random_maps();
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i, h = 20 + draw() % 80, w = 20 + draw() % 120;
        camera_lens camera;
        pad_shape pad;
        some_look l;
        fit_options o = {.max_profiles = 10 + draw() % 120, .dense_pixels = 40 + draw() % 400, .blur_px = 0.6, .edge_sigma_px = 0.004, .dense_edge_sigma_px = 0.01};
        tilt_prior prior = {.given = 1, .sigma_deck_rad = 0.03, .cov_tilt = {1e-4, 0.0, 0.0, 1e-4}};
        double start[12], *edges = malloc(5 * EDGE_POINTS * sizeof *edges), *outline = malloc((EDGE_POINTS + 3) / 4 * 2 * sizeof *outline);
        int32_t *edge_of = malloc(2 * EDGE_POINTS * sizeof *edge_of);
        looked_pad *out = calloc(1, sizeof *out);
        const int64_t most = 24 * (o.max_profiles + 2) > o.dense_pixels ? 24 * (o.max_profiles + 2) : o.dense_pixels;
        const int32_t room = (int32_t)((most > EDGE_POINTS ? most : EDGE_POINTS) + 15) / 16 * 16;
        const size_t samples = FINAL_SAMPLES + 2 * (size_t)(w + h) + 4 + SAMPLE_LANES;
        const size_t of_fit = (size_t)room * FIT_ROWS, of_sight = SCRATCH_ROWS * samples + (size_t)w + 2 * LOCAL_MAX;
        float *scratch = malloc((of_fit > of_sight ? of_fit : of_sight) * sizeof *scratch);
        uint8_t *parts = malloc((size_t)(2 * (3 * w * h / 4) + 24 * w));
        some_camera(&camera, h, w, 20.0 + draw() % 100, kind % 5 == 0);
        some_pad(&pad, 0.4, kind % 2);
        const pad_template drawn = random_template(HALF, pad.disc_radius_m);
        const double height_m = pad.disc_radius_m * camera.fx / (4.0 + draw() % (kind % 3 ? w / 2 : 4 * w));
        uint8_t *frame = picture(&camera, &pad, height_m, kind);
        double *rays = camera.distorted ? rays_of(&camera) : NULL;
        some_start(start, &camera, height_m, kind % 7 == 0 ? 5.0 : 0.4, kind % 5 == 4);
        some_edges(&pad, edges, edge_of);
        draw_look(kind, &l);
        if (look_at_pad(&camera, rays, frame, d.light, d.light, &pad, EDGE_POINTS, edges, edge_of, &drawn, d.maps, d.local, &l.judge, &prior, &o,
                        &l.quality, &l.how, &l.known, start, room, scratch, parts, out, outline)) {
            fold(&out->log_odds, 1), fold(out->evidence, EVIDENCE), fold(out->paint.mean, 25), fold(out->seen.d, 3), fold(outline, 200);
        }
        void *all[] = {out, scratch, parts, frame, rays, edges, edge_of, outline};
        for (size_t k = 0; k < sizeof all / sizeof *all; k++) {
            free(all[k]);
        }
    }
    forget(d);
}
