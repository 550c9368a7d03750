/* Lamps: frames of any size with none to thousands of lights, patterns of all sizes, and expected poses anywhere. */

static void draw_pattern(int kind, dl_lamp_pattern *pad)
{
    memset(pad, 0, sizeof *pad);
    pad->lamps = kind % 7 == 6 ? DL_LAMPS_MAX : 5 + draw() % 8, pad->pairs = kind % 5 == 4 ? DL_LAMP_PAIRS_MAX : 1 + draw() % 10;
    for (int k = 0; k < DL_LAMP_PAIRS_MAX; k++) {
        pad->pair[2 * k] = draw() % (int)pad->lamps;
        pad->pair[2 * k + 1] = (pad->pair[2 * k] + 1 + draw() % ((int)pad->lamps - 1)) % pad->lamps;
    }
    for (int k = 0; k < (int)pad->lamps; k++) {
        pad->x_m[k] = 0.4 * uniform(), pad->y_m[k] = 0.4 * uniform(), pad->radius_m[k] = 0.01;
    }
    poisoned(pad->x_m, 3 * DL_LAMPS_MAX + 1);
}

/* A square of light, which may be a pixel, at a place that may lie beyond the frame. */
static void shine(const dl_lens *c, double u, double v, int size, uint8_t *px)
{
    for (int i = -size; i <= size; i++) {
        for (int j = -size; j <= size; j++) {
            const double x = u + j, y = v + i;
            if (x >= 0.0 && y >= 0.0 && x < (double)c->width && y < (double)c->height) {
                memset(px + 3 * ((int64_t)y * c->width + (int64_t)x), 255 - 20 * (abs(i) + abs(j)), 3);
            }
        }
    }
}

static void light_frame(const dl_lens *c, const dl_lamp_pattern *pad, const dl_pad_pose *pose, int kind, uint8_t *px)
{
    const int lights = kind % 11 == 10 ? (int)(c->width * c->height / 6) : draw() % 8, noise = kind % 4 == 3 ? 200 : 1 + kind % 9;
    for (int64_t i = 0; i < 3 * c->width * c->height; i++) {
        px[i] = (uint8_t)(next_random() % noise);
    }
    for (int k = 0; k < lights; k++) {
        /* In statements of their own: compilers evaluate arguments in either order. */
        const double u = 0.5 * (1.0 + uniform()) * (double)c->width;
        const double v = 0.5 * (1.0 + uniform()) * (double)c->height;
        shine(c, u, v, kind % 11 == 10 ? 0 : kind % 4, px);
    }
    for (int k = 0; k < (int)pad->lamps && kind % 3; k++) {
        shine(c, c->cx + c->fx * (pad->x_m[k] + pose->t[0]) / pose->t[2], c->cy + c->fy * (pad->y_m[k] + pose->t[1]) / pose->t[2],
              kind % 3 - 1, px);
    }
}

static void look_for_lamps(int kind)
{
    dl_lens c = {kind % 6 == 5 ? 1 + draw() % 3 : 20 + draw() % 300, kind % 8 == 7 ? 1 + draw() % 3 : 20 + draw() % 200, kind % 5 == 1,
                     kind % 10 == 1, 90.0, 91.0, 0.0, 0.0, {0.02, -0.01, 0.001, 0.002, 0.001}, 0.0, {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}};
    dl_tilt_prior prior = {1, 0.02 * uniform(), 0.02 * uniform(), {1e-4, 0.0, 0.0, 1e-4}, 0.03};
    dl_expected_lamps at = {{{1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0}, {0.1 * uniform(), 0.1 * uniform(), 0.3 + 2.0 * fabs(uniform())}}, 8.0};
    dl_lamp_pattern pad;
    c.cx = 0.5 * (double)(c.width - 1), c.cy = 0.5 * (double)(c.height - 1);
    draw_pattern(kind, &pad);
    uint8_t *px = malloc((size_t)(3 * c.width * c.height));
    light_frame(&c, &pad, &at.pose, kind, px);
    poisoned(&c.fx, 18), poisoned(&prior.roll_rad, 7), poisoned(at.pose.R, 13);
    if (kind % 10 == 9) {
        c.fx = NAN, at.pose.t[kind % 3] = INFINITY;
    }
    const dl_image image = {c.width, c.height, 3 * c.width, 3, px};
    double *rays = c.distorted ? rays_of(&c) : NULL;
    dl_tracker *t = tracker_for(&c, rays, NULL, NULL, NULL, NULL);
    dl_found_lamps *out = calloc(1, sizeof *out);
    if (dl_find_lamps(t, &image, &pad, &prior, kind % 2 ? &at : NULL, out) == 1) {
        found += (double)out->lit;
        fold(out->pose.R, 12), fold(out->cov, 38), fold(out->seen.d, 3), fold(out->uv_px, 2 * (int)out->lit);
    }
    dl_tracker_free(t);
    free(px), free(rays), free(out);
}

static void lamps(int count)
{
    for (int i = 0; i < count; i++) {
        look_for_lamps(fuzzed ? draw() : i);
    }
}
