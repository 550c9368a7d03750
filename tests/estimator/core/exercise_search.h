/* The search with random images, planes and radii, each array exactly as long as it must be. */

static void look_for_circles(int kind)
{
    search_image image = {3 + draw() % 70, 3 + draw() % 50, 0, 0, 0, {1.0, 0.02, 0.1, -0.02, 1.0, 0.05, -0.1, -0.05, 1.0}};
    search_radii radii = {1 + draw() % SEARCH_RADII, 1 + draw() % 6, 0.08, 1.2};
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

static void turn_drawing(int kind)
{
    const camera_lens c = random_camera(kind % 2);
    const frame_part all = {kind % 3, 0, 0, c.width >> kind % 3, c.height >> kind % 3};
    pad_pose pose = {{1.0, 0.02, 0.01, -0.02, 1.0, 0.03, -0.01, -0.03, 1.0}, {0.3 * uniform(), 0.2 * uniform(), 0.8}};
    double side[2] = {0.6, 0.8};
    polar_pad pad;
    polar_fit out;
    int32_t stride;
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
    poisoned(pose.R, 12), poisoned(side, 2);
    uint8_t *px = part_pixels(&all, &stride);
    if (search_heading(&c, &pad, &pose, 1 << kind % 3, (int32_t)all.width, (int32_t)all.height, px, stride, kind % 4 ? NULL : side,
                       &out)) {
        fold(&out.turn_rad, 4);
    }
    free(px);
}

static void searches(int count)
{
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        look_for_circles(kind);
        turn_drawing(kind);
    }
}
