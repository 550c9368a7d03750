/* Alignment with random drawings, frames and poses, each array exactly as long as it must be. */

static pad_template random_template(int half, double radius_m)
{
    pad_template p;
    memset(&p, 0, sizeof p);
    p.n = 2 * half + 1, p.disc_channel = draw() % 3, p.arrow_rows = 3 + draw() % 5, p.arrow_columns = 3 + draw() % 5;
    p.per_m = half / (1.22 * radius_m), p.local_m = 0.15 * radius_m, p.reach_m = 1.22 * radius_m;
    p.disc_radius_m = radius_m, p.disc_edge_m = radius_m, p.h_half_length_m = 0.35 * radius_m, p.h_half_width_m = 0.25 * radius_m;
    p.ring_inner_m = 0.62 * radius_m, p.ring_outer_m = 0.67 * radius_m;
    p.disc_drawn = half % 2;
    p.arrow_tip_m = 0.77 * radius_m, p.arrow_depth_m = p.arrow_half_base_m = 0.12 * radius_m;
    p.arrow_margin_m = 0.05 * radius_m, p.arrow_pitch_m = 0.04 * radius_m;
    for (int k = 0; k < TEMPLATE_BLURS; k++) {
        p.log_blur[k] = log(0.0125 * radius_m * (1 << k));
    }
    for (int k = 0; k < 3; k++) {
        p.orange_place[k] = uniform();
        p.h_side[k] = k % 2 ? -1.0 : 1.0;
    }
    return p;
}

static camera_lens random_camera(int bent)
{
    camera_lens c = {40 + draw() % 60, 30 + draw() % 40, bent, 60.0 + uniform(), 60.0 + uniform(), 40.0, 25.0, {0.0}, {0.0}};
    for (int k = 0; k < 5 && bent; k++) {
        c.distortion[k] = 0.1 * uniform();
    }
    poisoned(c.distortion, 5);
    return c;
}

/* A part of a frame of random pixels, some bytes of padding after each row but the last. */
static uint8_t *part_pixels(const frame_part *part, int32_t *stride)
{
    *stride = (int32_t)(3 * part->width + draw() % 4);
    return room((size_t)*stride * (size_t)(part->height - 1) + 3 * (size_t)part->width);
}

static float *scratch_for(const frame_part *part)
{
    const size_t lanes = ((size_t)(part->width * part->height) + SAMPLE_LANES - 1) / SAMPLE_LANES * SAMPLE_LANES;
    return malloc((SCRATCH_ROWS * lanes + (size_t)part->width + 2 * LOCAL_MAX) * sizeof(float));
}

static void lay(const camera_lens *c, const pad_template *p, const int16_t *maps, const int16_t *local, const float *light, int kind)
{
    pad_pose pose = {{1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.1 * uniform(), 0.1 * uniform(), 0.0}};
    alignment how = {1 + kind % 5, kind % 2, kind % 3 == 0, 0.05, {0.6, 0.8}, {0.8, -0.6, uniform()}, kind % 4 ? 0.0 : 0.08};
    cover_line line;
    aligned_pad out;
    frame_part part, arrow, all = {kind % 3, 0, 0, c->width >> kind % 3, c->height >> kind % 3};
    double tilt = 0.0;
    pose.t[2] = p->disc_radius_m * (1.5 + 2.0 * fabs(uniform()));
    poisoned(pose.R, 12);
    if (!align_view(c, p, &pose, 100 + draw() % 2000, &part)) {
        return;
    }
    align_arrow_view(c, p, &pose, &arrow);
    int32_t stride, all_stride, arrow_stride;
    uint8_t *px = part_pixels(&part, &stride), *whole = part_pixels(&all, &all_stride), *arrow_px = part_pixels(&arrow, &arrow_stride);
    float *scratch = scratch_for(&part);
    frame_quality of;
    frame_noise(whole, all_stride, (int32_t)all.width, (int32_t)all.height, &of);
    fold(&of.noise, 3);
    poisoned(&how.sigma_tilt_rad, 7), poisoned(pose.R, 12), poisoned(&of.noise, 3);
    if (align_cover(c, p, maps, light, &part, px, stride, &pose, scratch, &line)) {
        fold(line.cut, 5);
    }
    if (align_fit(c, p, maps, local, light, &part, px, stride, &arrow, arrow_px, arrow_stride, &pose, 0.5, how.cut, &of, scratch, &out)) {
        fold(out.paints, (int)(sizeof out / sizeof(double)));
    }
    found += align_move(c, p, how.local ? local : maps, light, &part, px, stride, &how, &pose, &tilt, scratch);
    fold(pose.R, 12), fold(&tilt, 1);
    free(px), free(whole), free(arrow_px), free(scratch);
}

enum { HALF = 12, CELLS = TEMPLATE_BLURS * (2 * HALF + 1) * (2 * HALF + 1) * 4 };

/* A drawing's maps, and three tables of light. */
typedef struct {
    int16_t *maps, *local;
    float *light;
} drawn_maps;

static drawn_maps random_maps(void)
{
    const drawn_maps d = {malloc(CELLS * sizeof *d.maps), malloc(CELLS * sizeof *d.local), malloc(3 * 256 * sizeof *d.light)};
    for (int i = 0; i < CELLS; i++) {
        d.maps[i] = (int16_t)(next_random() % TEMPLATE_ONE);
        d.local[i] = (int16_t)(next_random() % (2 * TEMPLATE_ONE) - TEMPLATE_ONE);
    }
    for (int i = 0; i < 3 * 256; i++) {
        d.light[i] = (float)(i % 256) / 255.0f;
    }
    return d;
}

static void forget(drawn_maps d)
{
    free(d.maps), free(d.local), free(d.light);
}

static void alignments(int count)
{
    const drawn_maps d = random_maps();
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        const camera_lens c = random_camera(kind % 2);
        const pad_template p = random_template(HALF, 0.1 + 0.3 * (kind % 4));
        lay(&c, &p, d.maps, d.local, d.light, kind);
    }
    forget(d);
}
