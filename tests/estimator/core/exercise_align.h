/* Alignment with random drawings, frames and poses, each array exactly as long as it must be. */

/* A part of one level of a frame, px of that level. */
typedef struct {
    int64_t level, left, top, width, height;
} frame_part;

static dl_pad_template random_template(int half, double radius_m)
{
    dl_pad_template p;
    memset(&p, 0, sizeof p);
    p.n = 2 * half + 1, p.disc_channel = draw() % 3, p.arrow_rows = 3 + draw() % 5, p.arrow_columns = 3 + draw() % 5;
    p.per_m = half / (1.22 * radius_m), p.local_m = 0.15 * radius_m, p.reach_m = 1.22 * radius_m;
    p.disc_radius_m = radius_m, p.disc_edge_m = radius_m, p.h_half_length_m = 0.35 * radius_m, p.h_half_width_m = 0.25 * radius_m;
    p.ring_inner_m = 0.62 * radius_m, p.ring_outer_m = 0.67 * radius_m;
    p.disc_drawn = half % 2;
    p.arrow_tip_m = 0.77 * radius_m, p.arrow_depth_m = p.arrow_half_base_m = 0.12 * radius_m;
    p.arrow_margin_m = 0.05 * radius_m, p.arrow_pitch_m = 0.04 * radius_m;
    for (int k = 0; k < DL_TEMPLATE_BLURS; k++) {
        p.log_blur[k] = log(0.0125 * radius_m * (1 << k));
    }
    for (int k = 0; k < 3; k++) {
        p.orange_place[k] = uniform();
        p.h_side[k] = k % 2 ? -1.0 : 1.0;
    }
    return p;
}

static dl_lens random_camera(int bent)
{
    dl_lens c = {40 + draw() % 60, 30 + draw() % 40, bent, bent && draw() % 2,
                     60.0 + uniform(), 60.0 + uniform(), 40.0, 25.0, {0.0}, 0.0, {0.0}};
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

enum { HALF = 12, CELLS = DL_TEMPLATE_BLURS * (2 * HALF + 1) * (2 * HALF + 1) * 4 };

/* A drawing's maps. */
typedef struct {
    int16_t *maps, *local;
} drawn_maps;

static drawn_maps random_maps(void)
{
    const drawn_maps d = {malloc(CELLS * sizeof *d.maps), malloc(CELLS * sizeof *d.local)};
    for (int i = 0; i < CELLS; i++) {
        d.maps[i] = (int16_t)(next_random() % DL_TEMPLATE_ONE);
        d.local[i] = (int16_t)(next_random() % (2 * DL_TEMPLATE_ONE) - DL_TEMPLATE_ONE);
    }
    return d;
}

static void forget(drawn_maps d)
{
    free(d.maps), free(d.local);
}

/* A frame of random pixels, at full size and at some that are smaller, each with as many bytes as it must have. */
static void random_frame(const dl_lens *c, int levels, dl_frame *out)
{
    memset(out, 0, sizeof *out);
    for (int k = 0; k < levels; k++) {
        const frame_part all = {k, 0, 0, c->width >> k > 0 ? c->width >> k : 1, c->height >> k > 0 ? c->height >> k : 1};
        int32_t stride = (int32_t)(3 * all.width);
        uint8_t *px = k ? part_pixels(&all, &stride) : room((size_t)(3 * all.width * all.height));
        const dl_image one = {all.width, all.height, stride, 3, px};
        out->level[k] = one;
    }
    dl_frame_quality(&out->level[0], &out->quality);
}

static void forget_frame(dl_frame *frame)
{
    for (int k = 0; k <= DL_FRAME_LEVELS; k++) {
        free((void *)(uintptr_t)frame->level[k].px);
    }
}

/* A tracker of a drawing, or of none. */
static dl_tracker *tracker_for(const dl_lens *c, const double *rays, const dl_pad *pad, const drawn_maps *d, const double *edges,
                               const int32_t *edge_of)
{
    dl_camera camera = {*c, {0.1, 0.0, 0.05}, {0.0}, {0.0}};
    for (int i = 0; i < 256; i++) {
        camera.light[i] = i * i / 65025.0, camera.log_light[i] = log1p(100.0 * camera.light[i]);
    }
    return dl_tracker_new(&camera, rays, pad, d ? d->maps : NULL, d ? d->local : NULL, edges, edge_of, NULL);
}

/* A drawing of some pad, with a template of its size. */
static dl_pad *random_pad(double size, int kind)
{
    dl_pad *pad = calloc(1, sizeof *pad);
    some_pad(&pad->shape, size, kind % 2);
    pad->drawn = random_template(HALF, size);
    pad->edge_points = EDGE_POINTS;
    return pad;
}

static void lay(const dl_lens *c, const dl_pad *pad, const drawn_maps *d, int kind)
{
    double *rays = c->distorted ? rays_of(c) : NULL, *edges = malloc(5 * EDGE_POINTS * sizeof *edges);
    int32_t *edge_of = malloc(2 * EDGE_POINTS * sizeof *edge_of);
    some_edges(&pad->shape, edges, edge_of);
    dl_tracker *t = tracker_for(c, rays, pad, d, edges, edge_of);
    dl_pad_pose pose = {{1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.1 * uniform(), 0.1 * uniform(), 0.0}};
    dl_alignment how = {1 + kind % 5, kind % 2, kind % 3 == 0, 0, 0.05, {0.6, 0.8}, {0.8, -0.6, uniform()}};
    dl_aligned_pad out;
    dl_frame frame;
    pose.t[2] = pad->drawn.disc_radius_m * (1.5 + 2.0 * fabs(uniform()));
    random_frame(c, kind % 4 ? 1 : 1 + draw() % (DL_FRAME_LEVELS + 1), &frame);
    fold(&frame.quality.noise, 3);
    poisoned(&how.sigma_tilt_rad, 6), poisoned(pose.R, 12), poisoned(&frame.quality.noise, 3);
    for (int k = 0; k < 3; k++) {
        dl_pad_pose moved = pose;
        how.cover = k == 0, how.steps = k == 1 ? 0 : how.steps;
        memset(&out, 0, sizeof out);
        if (dl_align(t, &frame, &how, &moved, &out) == 1) {
            fold(out.paints, (int)(sizeof out / sizeof(double))), fold(moved.R, 12);
        }
        how.steps = 1 + kind % 5;
    }
    dl_tracker_free(t);
    forget_frame(&frame);
    free(rays), free(edges), free(edge_of);
}

static void alignments(int count)
{
    const drawn_maps d = random_maps();
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        const dl_lens c = random_camera(kind % 2);
        dl_pad *pad = random_pad(0.1 + 0.3 * (kind % 4), kind);
        lay(&c, pad, &d, kind);
        free(pad);
    }
    forget(d);
}
