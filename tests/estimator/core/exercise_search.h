/* The search with random images, planes and radii, each array exactly as long as it must be. */

static void look_for_circles(int kind)
{
    search_image image = {3 + draw() % 70, 3 + draw() % 50, 0, 0, 0, 1 << kind % 4,
                          {1.0, 0.02, 0.1, -0.02, 1.0, 0.05, -0.1, -0.05, 1.0}};
    search_radii radii = {1 + draw() % SEARCH_RADII, 1 + draw() % 6, kind % 3 == 0, 0.08, 1.2};
    image.stride = image.width + draw() % 5;
    image.margin = draw() % 30;
    image.room = kind % 5 ? image.width * image.height / 2 + 1 : draw() % 20;
    poisoned(image.R_cam_plane, 9), poisoned(&radii.least, 2);
    const size_t bytes = (size_t)image.stride * (size_t)(image.height - 1) + (size_t)image.width;
    const int columns = (int)(image.width + SEARCH_BLOCK - 1) / SEARCH_BLOCK + 1;
    const int rows = (int)(image.height + SEARCH_BLOCK - 1) / SEARCH_BLOCK + 1;
    uint8_t *grey = malloc(bytes);
    float *rays = malloc((size_t)(2 * columns * rows) * sizeof *rays), *scratch = malloc((size_t)search_room(&image) * sizeof *scratch);
    search_circle *out = malloc((size_t)radii.most * sizeof *out);
    const double u = 0.5 * (double)image.width, v = 0.5 * (double)image.height, radius = 6.0 + 6.0 * fabs(uniform());
    for (int i = 0; i < (int)bytes; i++) {
        const double x = i % (int)image.stride - u, y = i / (int)image.stride - v;
        grey[i] = (uint8_t)(80 + next_random() % (kind % 3 ? 8 : 170) + (x * x + y * y < radius * radius ? 70 : 0));
    }
    for (int i = 0; i < columns * rows; i++) {
        rays[2 * i] = (float)((i % columns * SEARCH_BLOCK - u) / 80.0);
        rays[2 * i + 1] = (float)((i / columns * SEARCH_BLOCK - v) / 80.0);
    }
    const int n = search_circles(&image, grey, rays, &radii, scratch, out);
    for (int i = 0; i < n; i++) {
        found += (double)out[i].points;
        fold(out[i].centre, 4);
    }
    free(grey), free(rays), free(scratch), free(out);
}

static polar_pad random_drawing(int kind)
{
    polar_pad pad;
    for (int k = 0; k < POLAR_RADII * POLAR_ANGLES; k++) {
        const double r = 0.02 * (1 + k / POLAR_ANGLES), a = 0.1309 * (k % POLAR_ANGLES);
        pad.xy_m[2 * k] = r * cos(a), pad.xy_m[2 * k + 1] = r * sin(a);
        pad.h_marking[k] = k / POLAR_ANGLES < 7 ? fabs(uniform()) : 0.0;
        pad.arrow[k] = k / POLAR_ANGLES == 12 && k % POLAR_ANGLES < 2;
    }
    for (int k = 0; k < POLAR_RADII; k++) {
        pad.area_inside[k] = k < 16 ? k / 9.0 : 0.0;
        pad.ring[k] = k == 10;
    }
    pad.polarity = kind % 2 ? 1.0 : -1.0;
    pad.radius_m = 0.36;
    return pad;
}

static void turn_drawing(int kind)
{
    const camera_lens c = random_camera(kind % 2);
    const frame_part all = {kind % 3, 0, 0, c.width >> kind % 3, c.height >> kind % 3};
    const polar_pad pad = random_drawing(kind);
    pad_pose pose = {{1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.3 * uniform(), 0.2 * uniform(), 0.8}};
    double side[2] = {0.6, 0.8};
    polar_fit out;
    int32_t stride;
    poisoned(pose.R, 12), poisoned(side, 2);
    uint8_t *px = part_pixels(&all, &stride);
    if (search_heading(&c, &pad, &pose, 1 << kind % 3, (int32_t)all.width, (int32_t)all.height, px, stride, kind % 4 ? NULL : side,
                       &out)) {
        fold(&out.turn_rad, 4);
    }
    free(px);
}

/* Ellipses, and what a poisoned one becomes. */
static void guess_poses(int kind)
{
    const camera_lens c = random_camera(kind % 2);
    const polar_pad pad = random_drawing(kind);
    search_frame frame = {SEARCH_LEVELS, kind % 3 == 0, 1 + draw() % 3, {0}, {0}, {0},
                          {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.36, 0.26, 0.24}, {0.0, 1.0, -1.0}};
    const int n = 1 + draw() % 3, most = 1 + draw() % 9;
    uint8_t *levels[SEARCH_LEVELS];
    search_circle *circles = calloc((size_t)n, sizeof *circles);
    search_guess *out = malloc((size_t)most * sizeof *out), *before = malloc((size_t)most * sizeof *before);
    int64_t rated[] = {-1, -1, -1};
    for (int k = 0; k < SEARCH_LEVELS; k++) {
        const frame_part all = {k, 0, 0, c.width >> k > 0 ? c.width >> k : 1, c.height >> k > 0 ? c.height >> k : 1};
        int32_t stride;
        levels[k] = part_pixels(&all, &stride);
        frame.width[k] = all.width, frame.height[k] = all.height, frame.stride[k] = stride;
    }
    for (int k = 0; k < n; k++) {
        search_circle *one = &circles[k];
        const double u = 0.5 * (double)c.width + 9.0 * uniform(), v = 0.5 * (double)c.height, r = 6.0 + 4.0 * uniform();
        one->bright_inside = draw() % 2;
        one->points = draw() % (SEARCH_SECTORS + 1);
        one->centre[0] = 0.1 * uniform(), one->radius = 0.2 + 0.1 * uniform(), one->support = 0.5 + 0.5 * uniform();
        for (int i = 0; i < SEARCH_SECTORS; i++) {
            const double a = 0.1745 * i;
            one->outline_px[2 * i] = u + r * cos(a) + 0.2 * uniform(), one->outline_px[2 * i + 1] = v + 0.9 * r * sin(a);
        }
        poisoned(one->centre, 4 + 2 * SEARCH_SECTORS);
    }
    poisoned(frame.R_cam_plane, 15);
    search_guesses(&c, &pad, &frame, (const uint8_t *const *)levels, n, circles, rated, out, most, before);
    const int found_now = search_guesses(&c, &pad, &frame, (const uint8_t *const *)levels, n, circles, rated, before, most, out);
    for (int i = 0; i < found_now; i++) {
        fold(out[i].t, 3);
        fold(&out[i].drawing, 1);
    }
    for (int k = 0; k < SEARCH_LEVELS; k++) {
        free(levels[k]);
    }
    free(circles), free(out), free(before);
}

/* An H on the image, upright or turned by a quarter. */
static void look_for_strokes(int kind)
{
    const camera_lens c = random_camera(kind % 2);
    strokes_image image = {24 + draw() % 60, 24 + draw() % 40, 0, 1 + draw() % 3, kind % 2, kind % 3 == 0,
                           {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}};
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e300, 1e-310, -1.0, 0.0};
    pad_strokes h = {0.28, 0.2, 0.04, 0.04, 0.035};
    if (kind % 3 == 2) {
        (&h.length_m)[kind % 5] = odd[kind % 7];
    }
    image.stride = 3 * image.width + draw() % 5;
    poisoned(image.R_cam_plane, 9), poisoned(&h.length_m, 5);
    const int most = 1 + draw() % 4, wide = 4 + draw() % 4;
    uint8_t *px = malloc((size_t)(image.stride * image.height));
    float *scratch = malloc((size_t)search_strokes_room(&image) * sizeof *scratch);
    search_guess *out = malloc((size_t)most * sizeof *out);
    for (int i = 0; i < (int)(image.stride * image.height); i++) {
        const int x = i % (int)image.stride / 3 - 8, y = i / (int)image.stride - 4, across = kind % 4 > 1;
        const int a = across ? y : x, b = across ? x : y, leg = (a >= 0 && a < wide) || (a >= 4 * wide && a < 5 * wide);
        const int marked = b >= 0 && b < 7 * wide && (leg || (a >= 0 && a < 5 * wide && b >= 3 * wide && b < 4 * wide));
        px[i] = (uint8_t)((marked == (kind % 2) ? 170 : 40) + (kind % 5 ? next_random() % 20 : next_random() % 80));
    }
    const int n = search_strokes(&c, &image, &h, px, scratch, most, out);
    for (int i = 0; i < n; i++) {
        fold(out[i].t, 3);
        fold(&out[i].drawing, 1);
    }
    free(px), free(scratch), free(out);
}

/* Ovals of another shade, some of them with an end beyond the image, among noise. */
static void look_for_blobs(int kind)
{
    const camera_lens c = random_camera(kind % 2);
    blob_image image = {1 + draw() % 90, 1 + draw() % 60, 0, 0, 0, 0, kind % 3 == 0, 1 + draw() % 80,
                        kind % 4 ? 1.0 : 6.0, {1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}};
    image.full_width = 2 * image.width + draw() % 2;
    image.full_height = 2 * image.height + draw() % 2;
    image.stride = 3 * image.width + draw() % 5;
    image.full_stride = 3 * image.full_width + draw() % 5;
    poisoned(&image.noise, 1), poisoned(image.R_cam_plane, 9);
    const size_t halves = (size_t)(image.stride * (image.height - 1) + 3 * image.width);
    const size_t all = (size_t)(image.full_stride * (image.full_height - 1) + 3 * image.full_width);
    uint8_t *half = malloc(halves), *full = malloc(all);
    float *scratch = malloc((size_t)search_blobs_room(&image) * sizeof *scratch);
    search_circle *out = malloc((size_t)image.most * sizeof *out);
    const double u = 0.5 * (double)image.full_width + 20.0 * uniform(), v = 0.5 * (double)image.full_height, r = 9.0 + 5.0 * uniform();
    for (size_t i = 0; i < all; i++) {
        const double x = (double)((int64_t)i % image.full_stride / 3) - u, y = (double)((int64_t)i / image.full_stride) - v;
        full[i] = (uint8_t)(90 + next_random() % (kind % 5 ? 6 : 120) + (x * x + 2.0 * y * y < r * r ? 40 : 0));
    }
    for (size_t i = 0; i < halves; i++) {
        const int64_t x = (int64_t)i % image.stride, y = (int64_t)i / image.stride;
        const size_t from = (size_t)(2 * y * image.full_stride + (x < 3 * image.width ? 6 * (x / 3) + x % 3 : 0));
        half[i] = full[from];
    }
    const int n = search_blobs(&c, &image, half, full, scratch, out);
    for (int i = 0; i < n; i++) {
        found += (double)out[i].points;
        fold(out[i].centre, 3);
    }
    free(half), free(full), free(scratch), free(out);
}

static void searches(int count)
{
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        look_for_circles(kind);
        turn_drawing(kind);
        guess_poses(kind);
        look_for_strokes(kind);
        look_for_blobs(kind);
    }
}
