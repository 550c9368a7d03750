/* Pads of many sizes and pictures of them: drawn sharp, in noise, in the dark, half hidden, or not there. */

static void circle_region(dl_pad_region *region, double inner_m, double outer_m)
{
    region->circles = inner_m > 0.0 ? 2 : 1, region->figure = -1;
    region->radius_m[0] = outer_m, region->radius_m[1] = inner_m;
    region->sign[0] = 1.0, region->sign[1] = -1.0;
}

static void rectangle(dl_pad_figure *figure, int index, int x0, int x1, int y0, int y1)
{
    figure->rectangles = index + 1;
    figure->x0[index] = x0, figure->x1[index] = x1, figure->y0[index] = y0, figure->y1[index] = y1;
}

/* The sides of a square that stands on a corner. */
static void slanted_square(dl_pad_figure *figure, double half)
{
    const double x[4] = {half, 0.0, -half, 0.0}, y[4] = {0.0, half, 0.0, -half};
    figure->sides = 4;
    for (int k = 0; k < 4; k++) {
        figure->from_x_m[k] = x[k], figure->from_y_m[k] = y[k];
        figure->to_x_m[k] = x[(k + 1) % 4], figure->to_y_m[k] = y[(k + 1) % 4];
    }
}

/* A disc with a ring, a cross with a slanted square on it and a pointer, with a rim or without one, of any size. */
static void some_pad(dl_pad_shape *pad, double size, int with_rim)
{
    const double cuts[4] = {-0.3, -0.1, 0.1, 0.3}, tip[3] = {0.66, 0.71, 0.76}, side[3] = {-0.1, 0.0, 0.1};
    memset(pad, 0, sizeof *pad);
    const int upper = 3 + with_rim;
    pad->contrast_count = upper + 1, pad->pointer_kind = 2, pad->pointer_contrast = 1, pad->pointer_figure = 1;
    for (int k = 0; k < DL_PAD_CONTRASTS; k++) {
        pad->lies_on[k] = k == upper ? 2 : k == 0 || k == 3 ? -1 : 0;
        pad->contrast_of_kind[k] = k == 4 ? upper : k < 2 ? k : k - 1;
    }
    pad->disc_radius_m = size, pad->half_length_m = 0.3 * size, pad->pointer_clear_m = 0.6 * size;
    circle_region(&pad->contrasts[0], 0.0, (with_rim ? 0.92 : 1.0) * size), circle_region(&pad->contrasts[1], 0.6 * size, 0.66 * size);
    circle_region(&pad->contrasts[3], 0.92 * size, size);
    pad->contrasts[1].figure = 1, pad->contrasts[2].figure = 0;
    memset(&pad->contrasts[upper], 0, sizeof pad->contrasts[upper]);
    pad->contrasts[upper].figure = 3;
    slanted_square(&pad->figures[3], 0.09 * size);
    for (int k = 0; k < 4; k++) {
        pad->figures[0].x_m[k] = pad->figures[0].y_m[k] = cuts[k] * size;
        pad->figures[1].x_m[k] = tip[k % 3] * size, pad->figures[1].y_m[k] = side[k % 3] * size;
    }
    pad->figures[0].x_cuts = pad->figures[0].y_cuts = 4, pad->figures[1].x_cuts = pad->figures[1].y_cuts = 3;
    rectangle(&pad->figures[0], 0, 0, 3, 0, 1), rectangle(&pad->figures[0], 1, 0, 3, 2, 3), rectangle(&pad->figures[0], 2, 1, 2, 1, 2);
    rectangle(&pad->figures[1], 0, 0, 2, 0, 1), rectangle(&pad->figures[1], 1, 0, 1, 1, 2);
    pad->kinds[0] = pad->contrasts[0], pad->kinds[3] = pad->contrasts[2], pad->kinds[4] = pad->contrasts[upper];
    circle_region(&pad->kinds[1], 0.6 * size, 0.66 * size), circle_region(&pad->kinds[2], 0.6 * size, 0.66 * size);
    pad->kinds[2].has_wedge = 1;
    pad->gap_m = 0.1 * size;
    for (int k = 0; k < DL_EDGE_KINDS; k++) {
        pad->paint_of_kind[k] = k == 2 ? 1 : k;
        pad->nominal[3 * k] = k ? 0.6 : 0.0, pad->nominal[3 * k + 1] = k ? 0.8 : 0.0;
        pad->zones[k].inside_m = k == 0 ? 0.66 * size : -1e6, pad->zones[k].outside_m = k == 3 ? 0.6 * size : k ? 0.9 * size : 1e6;
        pad->zones[k].thinnest_m = 1e6, pad->zones[k].on_figure = k == 4 ? 0 : -1, pad->zones[k].beside_figure = k == 3 ? 3 : -1;
    }
    for (int k = 0; k < DL_POINTER_MARKS; k++) {
        pad->pointer_marks_m[2 * k] = (0.6 + 0.05 * k) * size;
    }
    pad->wedge.sides = 3, pad->wedge.beyond_m = 0.66 * size;
    for (int k = 0; k < 3; k++) {
        pad->wedge.nx[k] = k < 2 ? 0.7071 : -1.0, pad->wedge.ny[k] = k < 2 ? 0.7071 - 1.4142 * k : 0.0;
        pad->wedge.offset_m[k] = (k < 2 ? 0.7071 * 0.78 : -0.4) * size;
    }
}

static void some_camera(dl_lens *camera, int h, int w, double focal_px, int distorted)
{
    memset(camera, 0, sizeof *camera);
    camera->width = w, camera->height = h, camera->distorted = distorted;
    camera->fx = focal_px, camera->fy = 1.01 * focal_px, camera->cx = 0.5 * w - 0.3, camera->cy = 0.5 * h + 0.2;
    camera->distortion[0] = distorted ? -0.1 : 0.0, camera->distortion[2] = distorted ? 0.001 : 0.0;
    camera->R_body_cam[1] = -1.0, camera->R_body_cam[3] = 1.0, camera->R_body_cam[8] = 1.0;
}

static int in_figure(const dl_pad_figure *figure, double x, double y)
{
    for (int r = 0; r < figure->rectangles; r++) {
        if (x > figure->x_m[figure->x0[r]] && x < figure->x_m[figure->x1[r]] && y > figure->y_m[figure->y0[r]] &&
            y < figure->y_m[figure->y1[r]]) {
            return 1;
        }
    }
    return 0;
}

/* The paint at a point of the pad's plane: 0 for the surroundings, else the region plus one. */
static int paint_of(const dl_pad_shape *pad, double x, double y)
{
    const double r = sqrt(x * x + y * y), ring = pad->contrasts[1].radius_m[0], hole = pad->contrasts[1].radius_m[1];
    if (fabs(x) + fabs(y) < pad->figures[3].from_x_m[0]) {
        return 5;
    }
    if (in_figure(&pad->figures[0], x, y)) {
        return 3;
    }
    if ((r < ring && r > hole) || in_figure(&pad->figures[1], x, y)) {
        return 2;
    }
    return r < pad->contrasts[0].radius_m[0] ? 1 : r < pad->disc_radius_m ? 4 : 0;
}

/* A picture of the pad at `height_m` below, each pixel the mean of nine rays. `kind` says what is wrong with it. */
static uint8_t *picture(const dl_lens *camera, const dl_pad_shape *pad, double height_m, int kind)
{
    static const int colours[6][3] = {{120, 118, 115}, {20, 110, 30}, {20, 90, 210}, {230, 235, 240}, {40, 30, 200}, {190, 20, 20}};
    const int w = (int)camera->width, h = (int)camera->height;
    uint8_t *frame = malloc((size_t)(3 * w * h));
    for (int i = 0; i < w * h; i++) {
        double sum[3] = {0.0, 0.0, 0.0};
        for (int k = 0; k < 9; k++) {
            const double x = (i % w + (k % 3 - 1) / 3.0 - camera->cx) / camera->fx * height_m;
            const double y = (i / w + (k / 3 - 1) / 3.0 - camera->cy) / camera->fy * height_m;
            const int paint = kind % 4 == 3 && x > 0.1 * pad->disc_radius_m ? 0 : paint_of(pad, x, y);
            for (int c = 0; c < 3; c++) {
                sum[c] += colours[paint][c] / 9.0;
            }
        }
        for (int c = 0; c < 3; c++) {
            const double lit = kind % 4 == 2 ? sum[c] + 200.0 * (i % w > w / 2) : kind % 8 == 5 ? 0.04 * sum[c] : sum[c];
            const double seen = lit + (kind % 4 == 1 ? 60.0 : 2.0) * uniform();
            frame[3 * i + c] = (uint8_t)(seen < 0.0 ? 0.0 : seen > 255.0 ? 255.0 : seen);
        }
    }
    return frame;
}

static double *rays_of(const dl_lens *camera)
{
    const int w = (int)camera->width, n = w * (int)camera->height;
    double *rays = malloc((size_t)n * 2 * sizeof *rays);
    for (int i = 0; i < n; i++) {
        rays[2 * i] = (i % w - camera->cx) / camera->fx, rays[2 * i + 1] = (i / w - camera->cy) / camera->fy;
    }
    return rays;
}

/* About as the pad is seen in the picture, turned by half a turn, or anything. */
static void some_start(double start[12], const dl_lens *camera, double height_m, double off, int turned)
{
    for (int i = 0; i < 9; i++) {
        start[i] = i % 4 == 0 ? (turned && i < 8 ? -1.0 : 1.0) : 0.0;
    }
    for (int i = 0; i < 3; i++) {
        start[9 + i] = off * height_m / camera->fx * uniform() + (i == 2 ? height_m : 0.0);
    }
    poisoned(start, 12);
}

/* Points on the circles of the disc and the ring, on two sides of the cross and on one of the square; the pieces follow one another. */
enum { EDGE_POINTS = 400, EDGE_PIECES = 5 };
static void some_edges(const dl_pad_shape *pad, double *edges, int32_t *of)
{
    const double radii[2] = {pad->contrasts[0].radius_m[0], pad->contrasts[1].radius_m[0]};
    for (int i = 0; i < EDGE_POINTS; i++) {
        const int piece = i / (EDGE_POINTS / EDGE_PIECES), k = i % (EDGE_POINTS / EDGE_PIECES);
        const double a = 6.283185307179586 * k / (EDGE_POINTS / EDGE_PIECES), side = piece == 2 ? 1.0 : -1.0, size = pad->disc_radius_m;
        double *at = edges + 5 * i;
        at[2] = piece < 2 ? cos(a) : 0.0, at[3] = piece < 2 ? sin(a) : side;
        at[0] = piece < 2 ? radii[piece] * at[2] : 0.6 * size * (k / ((double)EDGE_POINTS / EDGE_PIECES) - 0.5);
        at[1] = piece < 2 ? radii[piece] * at[3] : 0.3 * size * side;
        at[4] = piece < 2 ? radii[piece] * 6.283185307179586 / (EDGE_POINTS / EDGE_PIECES) : 0.6 * size / (EDGE_POINTS / EDGE_PIECES);
        of[2 * i] = piece < 2 ? piece : piece < 4 ? 3 : 4, of[2 * i + 1] = piece;
        if (piece == 4) {
            const double half = pad->figures[3].from_x_m[0], part = (k + 0.5) / (EDGE_POINTS / EDGE_PIECES);
            at[0] = (1.0 - part) * half, at[1] = part * half, at[2] = at[3] = 0.7071;
            at[4] = 1.4142 * half / (EDGE_POINTS / EDGE_PIECES);
        }
    }
}
