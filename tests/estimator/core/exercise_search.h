/* The search with random images, planes and radii, each array exactly as long as it must be. */

static void fold_circles(const dl_circle *out, int n)
{
    for (int i = 0; i < n; i++) {
        found += (double)out[i].points;
        fold(out[i].centre, 4);
    }
}

static void look_for_circles(int kind)
{
    const int w = 3 + draw() % 70, h = 3 + draw() % 50;
    dl_lens c;
    dl_circle_search how = {1 << kind % 4, draw() % 30, 1 + draw() % DL_SEARCH_RADII, 1 + draw() % 6, kind % 3 == 0, 0, 0.08, 1.2,
                            {1.0, 0.02, 0.1, -0.02, 1.0, 0.05, -0.1, -0.05, 1.0}};
    dl_image image = {w, h, w + draw() % 5, 1, NULL};
    poisoned(how.R_cam_plane, 9), poisoned(&how.least, 2);
    /* The largest margins and the smallest images are not those of the camera's frame, and are refused. */
    some_camera(&c, h + draw() % 60, w + draw() % 60, 80.0, 0);
    const size_t bytes = (size_t)image.stride * (size_t)(h - 1) + (size_t)w;
    const int columns = (w + DL_SEARCH_BLOCK - 1) / DL_SEARCH_BLOCK + 1, rows = (h + DL_SEARCH_BLOCK - 1) / DL_SEARCH_BLOCK + 1;
    uint8_t *grey = malloc(bytes);
    float *rays = malloc((size_t)(2 * columns * rows) * sizeof *rays);
    dl_circle *out = malloc((size_t)how.most * sizeof *out);
    const double u = 0.5 * w, v = 0.5 * h, radius = 6.0 + 6.0 * fabs(uniform());
    for (int i = 0; i < (int)bytes; i++) {
        const double x = i % (int)image.stride - u, y = i / (int)image.stride - v;
        grey[i] = (uint8_t)(80 + next_random() % (kind % 3 ? 8 : 170) + (x * x + y * y < radius * radius ? 70 : 0));
    }
    for (int i = 0; i < columns * rows; i++) {
        rays[2 * i] = (float)((i % columns * DL_SEARCH_BLOCK - u) / 80.0);
        rays[2 * i + 1] = (float)((i / columns * DL_SEARCH_BLOCK - v) / 80.0);
    }
    image.px = grey;
    dl_tracker *t = tracker_for(&c, NULL, NULL, NULL, NULL, NULL);
    fold_circles(out, dl_search_circles(t, NULL, &image, rays, &how, out));
    dl_tracker_free(t);
    free(grey), free(rays), free(out);
}

static dl_polar_pad random_drawing(int kind)
{
    dl_polar_pad pad;
    for (int k = 0; k < DL_POLAR_RADII * DL_POLAR_ANGLES; k++) {
        const double r = 0.02 * (1 + k / DL_POLAR_ANGLES), a = 0.1309 * (k % DL_POLAR_ANGLES);
        pad.xy_m[2 * k] = r * cos(a), pad.xy_m[2 * k + 1] = r * sin(a);
        pad.h_marking[k] = k / DL_POLAR_ANGLES < 7 ? fabs(uniform()) : 0.0;
        pad.arrow[k] = k / DL_POLAR_ANGLES == 12 && k % DL_POLAR_ANGLES < 2;
    }
    for (int k = 0; k < DL_POLAR_RADII; k++) {
        pad.area_inside[k] = k < 16 ? k / 9.0 : 0.0;
        pad.ring[k] = k == 10;
    }
    pad.polarity = kind % 2 ? 1.0 : -1.0;
    pad.radius_m = 0.36;
    return pad;
}

static void turn_drawing(dl_tracker *t, const dl_lens *c, int kind)
{
    const frame_part all = {kind % 3, 0, 0, c->width >> kind % 3, c->height >> kind % 3};
    dl_pad_pose pose = {{1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.3 * uniform(), 0.2 * uniform(), 0.8}};
    double side[2] = {0.6, 0.8};
    dl_polar_fit out;
    int32_t stride;
    poisoned(pose.R, 12), poisoned(side, 2);
    uint8_t *px = part_pixels(&all, &stride);
    const dl_image image = {all.width, all.height, stride, 3, px};
    if (dl_search_heading(t, &image, 1 << kind % 3, &pose, kind % 4 ? NULL : side, &out) == 1) {
        fold(&out.turn_rad, 4);
    }
    free(px);
}

/* Ellipses, and what a poisoned one becomes. */
static void guess_poses(dl_tracker *t, const dl_lens *c, int kind)
{
    const int n = 1 + draw() % 3;
    dl_guess_search how = {kind % 3 == 0, 1 + draw() % 3, 1 + draw() % 9, 0,
                           {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.36, 0.26, 0.24}, {0.0, 1.0, -1.0}};
    dl_frame frame;
    dl_circle *circles = calloc((size_t)n, sizeof *circles);
    dl_guess *out = malloc((size_t)how.most * sizeof *out), *before = malloc((size_t)how.most * sizeof *before);
    int64_t rated[] = {-1, -1, -1};
    random_frame(c, DL_SEARCH_LEVELS, &frame);
    for (int k = 0; k < n; k++) {
        dl_circle *one = &circles[k];
        const double u = 0.5 * (double)c->width + 9.0 * uniform(), v = 0.5 * (double)c->height, r = 6.0 + 4.0 * uniform();
        one->bright_inside = draw() % 2;
        one->points = draw() % (DL_SEARCH_SECTORS + 1);
        one->centre[0] = 0.1 * uniform(), one->radius = 0.2 + 0.1 * uniform(), one->support = 0.5 + 0.5 * uniform();
        for (int i = 0; i < DL_SEARCH_SECTORS; i++) {
            const double a = 0.1745 * i;
            one->outline_px[2 * i] = u + r * cos(a) + 0.2 * uniform(), one->outline_px[2 * i + 1] = v + 0.9 * r * sin(a);
        }
        poisoned(one->centre, 4 + 2 * DL_SEARCH_SECTORS);
    }
    poisoned(how.R_cam_plane, 15);
    const int first = dl_search_guesses(t, &frame, &how, n, circles, rated, out, before);
    how.before = first > 0 ? first : 0;
    const int found_now = dl_search_guesses(t, &frame, &how, n, circles, rated, before, out);
    for (int i = 0; i < found_now; i++) {
        fold(out[i].t, 3);
        fold(&out[i].drawing, 1);
    }
    forget_frame(&frame);
    free(circles), free(out), free(before);
}

/* An H on the image, upright or turned by a quarter. */
static void look_for_strokes(dl_tracker *t, const dl_lens *c, int kind)
{
    dl_stroke_search how = {1 + draw() % 3, kind % 2, kind % 3 == 0, 1 + draw() % 4, {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}};
    const int w = (int)c->width - draw() % 8, h = (int)c->height - draw() % 8, wide = 4 + draw() % 4;
    dl_image image = {w, h, 3 * w + draw() % 5, 3, NULL};
    poisoned(how.R_cam_plane, 9);
    uint8_t *px = malloc((size_t)(image.stride * h));
    dl_guess *out = malloc((size_t)how.most * sizeof *out);
    for (int i = 0; i < (int)(image.stride * h); i++) {
        const int x = i % (int)image.stride / 3 - 8, y = i / (int)image.stride - 4, across = kind % 4 > 1;
        const int a = across ? y : x, b = across ? x : y, leg = (a >= 0 && a < wide) || (a >= 4 * wide && a < 5 * wide);
        const int marked = b >= 0 && b < 7 * wide && (leg || (a >= 0 && a < 5 * wide && b >= 3 * wide && b < 4 * wide));
        px[i] = (uint8_t)((marked == (kind % 2) ? 170 : 40) + (kind % 5 ? next_random() % 20 : next_random() % 80));
    }
    image.px = px;
    const int n = dl_search_strokes(t, &image, &how, out);
    for (int i = 0; i < n; i++) {
        fold(out[i].t, 3);
        fold(&out[i].drawing, 1);
    }
    free(px), free(out);
}

/* Ovals of another shade, some of them with an end beyond the image, among noise. */
static void look_for_blobs(int kind)
{
    const int w = 1 + draw() % 180, h = 1 + draw() % 120, half_w = w > 1 ? w / 2 : 1, half_h = h > 1 ? h / 2 : 1;
    const int stride = 3 * half_w + draw() % 5;
    dl_circle_search how = {.most = 1 + draw() % 80, .grey = kind % 3 == 0, .R_cam_plane = {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}};
    dl_lens c;
    some_camera(&c, h, w, 80.0, kind % 2);
    double *lens_rays = c.distorted ? rays_of(&c) : NULL;
    poisoned(how.R_cam_plane, 9);
    const size_t halves = (size_t)(stride * (half_h - 1) + 3 * half_w), all = (size_t)(3 * w * h);
    uint8_t *half = malloc(halves), *full = malloc(all);
    dl_circle *out = malloc((size_t)how.most * sizeof *out);
    const double u = 0.5 * w + 20.0 * uniform(), v = 0.5 * h, r = 9.0 + 5.0 * uniform();
    for (size_t i = 0; i < all; i++) {
        const double x = (double)(i % (size_t)(3 * w) / 3) - u, y = (double)(i / (size_t)(3 * w)) - v;
        full[i] = (uint8_t)(90 + next_random() % (kind % 5 ? 6 : 120) + (x * x + 2.0 * y * y < r * r ? 40 : 0));
    }
    for (size_t i = 0; i < halves; i++) {
        const int x = (int)(i % (size_t)stride), y = (int)(i / (size_t)stride), at = x < 3 * half_w ? 6 * (x / 3) + x % 3 : 0;
        half[i] = full[2 * y < h ? (size_t)(2 * y * 3 * w + (at < 3 * w ? at : 0)) : 0];
    }
    dl_frame frame = {.level = {{w, h, 3 * w, 3, full}, {half_w, half_h, stride, 3, half}}, .quality = {kind % 4 ? 1.0 / 127.5 : 6.0 / 127.5, 1.0, 0.0}};
    poisoned(&frame.quality.noise, 1);
    dl_tracker *t = tracker_for(&c, lens_rays, NULL, NULL, NULL, NULL);
    fold_circles(out, dl_search_circles(t, &frame, NULL, NULL, &how, out));
    dl_tracker_free(t);
    free(half), free(full), free(out), free(lens_rays);
}

static void search_with_drawing(const drawn_maps *d, int kind)
{
    const dl_lens c = random_camera(kind % 2);
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e300, 1e-310, -1.0, 0.0};
    double *rays = c.distorted ? rays_of(&c) : NULL, *edges = malloc(5 * EDGE_POINTS * sizeof *edges);
    int32_t *edge_of = malloc(2 * EDGE_POINTS * sizeof *edge_of);
    dl_pad *pad = random_pad(0.36, kind);
    const dl_pad_strokes h = {0.28, 0.2, 0.04, 0.04, 0.035};
    pad->polar = random_drawing(kind), pad->strokes = h;
    if (kind % 3 == 2) {
        (&pad->strokes.length_m)[kind % 5] = odd[kind % 7];
    }
    poisoned(&pad->strokes.length_m, 5);
    some_edges(&pad->shape, edges, edge_of);
    dl_tracker *t = tracker_for(&c, rays, pad, d, edges, edge_of);
    turn_drawing(t, &c, kind);
    guess_poses(t, &c, kind);
    look_for_strokes(t, &c, kind);
    dl_tracker_free(t);
    free(rays), free(edges), free(edge_of), free(pad);
}

static void searches(int count)
{
    const drawn_maps d = random_maps();
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        look_for_circles(kind);
        search_with_drawing(&d, kind);
        look_for_blobs(kind);
    }
    forget(d);
}
