/* The renderer's functions with random scenes of many sizes, each array exactly as long as it must be. */

static void *room(size_t bytes)
{
    unsigned char *made = malloc(bytes);
    for (size_t i = 0; i < bytes; i++) {
        made[i] = (unsigned char)next_random();
    }
    return made;
}

static float *floats(int n, float scale)
{
    float *made = malloc((size_t)n * sizeof(float));
    for (int i = 0; i < n; i++) {
        made[i] = scale * (float)uniform();
    }
    /* Finite, as every scene is: the renderer believes its caller, the simulator. */
    for (int left = fuzzed ? fuzzed_byte() % 8 : 0; left > 0; left--) {
        made[draw() % n] = 1e6f * (float)(fuzzed_byte() - 128) / 128.0f;
    }
    return made;
}

static int16_t *light_of(int n)
{
    int16_t *made = room((size_t)n * 2);
    for (int i = 0; i < n; i++) {
        made[i] &= 32767;
    }
    return made;
}

static void surface(int h, int w, float scale, int with_mask)
{
    const int columns = (w + CELL_PX - 1) / CELL_PX + 2, rows = (h + CELL_PX - 1) / CELL_PX + 2, tile = 16;
    float *cells = floats(2 * rows * columns, scale), *slow = floats(2 * (rows / 2 + 1) * (columns / 2 + 1), 300.0f);
    float *near = floats(2 * rows * columns, 1.0f);
    int16_t *gain = light_of(h * w);
    int16_t *texels = room((size_t)(tile + 1) * (tile + 1) * 2);
    uint16_t *scene = room((size_t)h * w * 8), *drawing = room(8 * 20 * 30), *smeared = room((size_t)h * w * 8);
    uint8_t *mask = room((size_t)h * w), *codes = room((size_t)h * w / 4), *colour = room(256 * 8);
    const int32_t sizes[4] = {tile, tile, tile, tile}, points[SEA_OUTLINES] = {with_mask ? 4 : 0, 3, 0}, shifts[6] = {-3, 2, 0, 0, 3, -2};
    const int32_t apart[4] = {-draw() % 40, 3, draw() % 40, -draw() % 5};
    const uint16_t weights[3] = {20000, 25535, 20000};
    const double drift[12] = {0.3, 1e3, -1e3, 2.0, 0.1, 0.2, 1.0, 0.0, 0.0, 4.0, -0.5, 0.5};
    const float strength[7] = {0.5f, 0.8f, 1.0f, 120.0f, 0.5f, 110.0f, 130.0f}, soft_m[SEA_OUTLINES] = {0.4f, 0.5f, 1.2f}, shape[4] = {0.14f, 0.115f, 0.2f, 0.05f};
    const double outlines[14] = {-9.0, -4.0, 9.0, -4.0, 9.0, 4.0, -9.0, 4.0, 1.0, 1.0, 3.0, 7.0, 6.0, 1.0};
    int32_t part[8];
    const double to_sun[3] = {0.3, 0.4, -0.86}, turn[9] = {0.9, 0.1, 0.0, -0.1, 0.9, 0.05, 0.0, 0.02, 1.0};
    const wave swell[2] = {{0.4, {0.3, 0.1}, 1.2, 0.5}, {1.0, {-0.05, 0.2}, 0.8, 2.0}};
    render_deck(w, 1, w - 1, 1, h - 1, cells, columns, drawing, 20, 30, with_mask ? mask : 0, scene);
    render_fill(w, 0, w, 0, h, mask, (const uint16_t *)colour, scene);
    render_smear(h, w, scene, 3, shifts, weights, smeared);
    fold_bytes(smeared, (size_t)h * w * 8);
    render_average(h, w, scene, apart, smeared);
    render_sea(h, w, with_mask ? mask : 0, 0, w / 2, 0, h / 2, cells, columns, texels, texels, texels, texels, sizes, drift, strength, slow,
               outlines, points, soft_m, codes);
    render_shadow(h, w, near, columns, shape, 0.02f, 0.45f, with_mask ? mask : 0, gain, part);
    render_bounds(h, w, mask, part, part + 4);
    fold_bytes(part, sizeof part);
    render_meet(rows * columns, cells, turn, 1e5, near);
    fold_bytes(near, sizeof(float) * 2 * (size_t)(rows * columns));
    fold_bytes(gain, (size_t)h * w * 2), fold_bytes(codes, (size_t)h * w / 4);
    render_swell(rows, columns, cells, turn, turn, to_sun, 3.0, with_mask ? 2 : 0, swell, slow);
    render_water(w, 0, w, 0, h, codes, (const uint16_t *)colour, with_mask ? mask : 0, scene);
    fold_bytes(scene, (size_t)h * w * 8), fold_bytes(smeared, (size_t)h * w * 8), fold_bytes(codes, (size_t)h * w / 4);
    void *all[] = {cells, slow, near, gain, texels, scene, drawing, smeared, mask, codes, colour};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

static void pad_in_light(int h, int w, float height_m, int rolling, int radius)
{
    const float drawing[][PAD_REGION] = {
        {PAD_ANNULUS, PAD_DISC, PAD_NONE, 0.0f, 0.38f, -1.0f, 0.38f},
        {PAD_ANNULUS, PAD_RIM, PAD_NONE, 0.38f, 0.39f, 0.38f, 0.39f},
        {PAD_ANNULUS, PAD_ORANGE, PAD_DISC, 0.243f, 0.261f, 0.243f, 0.261f},
        {PAD_ARROW, PAD_ORANGE, PAD_DISC, 0.252f, 0.3f, 0.3f, 0.252f, 0.7071f, 0.7071f},
        {PAD_RECTANGLE, PAD_WHITE, PAD_DISC, 0.06f, 0.1721f, -0.14f, 0.14f, -0.1f, -0.06f},
        {PAD_RECTANGLE, PAD_WHITE, PAD_DISC, 0.06f, 0.1721f, -0.14f, 0.14f, 0.06f, 0.1f},
        {PAD_RECTANGLE, PAD_WHITE, PAD_DISC, 0.0f, 0.0633f, -0.02f, 0.02f, -0.06f, 0.06f},
        {PAD_POLYGON, PAD_UPPER, PAD_WHITE, 0.0f, 0.015f, 4, 0.7071f, 0.7071f, 0.0106f, -0.7071f, 0.7071f, 0.0106f, -0.7071f, -0.7071f,
         0.0106f, 0.7071f, -0.7071f, 0.0106f},
    };
    const int32_t regions = sizeof drawing / sizeof *drawing;
    const float change[4] = {1.0f / 100.0f, 0.0f, 0.0f, 1.0f / 100.0f}, exposure[4] = {0.2f, 0.2f, 0.2f, 0.0f};
    const int squares = (w + CELL_PX - 1) / CELL_PX + 2, square_rows = (h + CELL_PX - 1) / CELL_PX + 2;
    float *middles = malloc((size_t)squares * square_rows * 2 * sizeof(float));
    for (int i = 0; i < squares * square_rows; i++) {
        middles[2 * i] = ((float)(CELL_PX * (i % squares - 1)) + 3.5f - 0.5f * (float)w) * change[0];
        middles[2 * i + 1] = ((float)(CELL_PX * (i / squares - 1)) + 3.5f - 0.5f * (float)h) * change[3];
    }
    float *rays = malloc((size_t)h * w * 2 * sizeof(float)), *strokes = floats(2 * STROKE_NUMBERS, 0.02f);
    for (int i = 0; i < h * w; i++) {
        rays[2 * i] = ((float)(i % w) - 0.5f * (float)w) * change[0];
        rays[2 * i + 1] = ((float)(i / w) - 0.5f * (float)h) * change[3];
    }
    for (int part = 0; part < 2 * STROKE_NUMBERS; part += 9) {
        const float sign = part % STROKE_NUMBERS == 9 ? 0.05f : 1.0f;
        strokes[part] += sign;
        strokes[part + 4] += sign;
        strokes[part + 8] += sign / height_m;
    }
    const int values = 3 * w;
    uint8_t *kinds = room((size_t)h * w), *frame = room((size_t)h * values), *codes = room(65536);
    int32_t *edges = room((size_t)h * w * 4);
    uint16_t *scene = room((size_t)h * w * 8), *pad_scene = room(PAD_PAINTS * 8), *taps = room(62);
    uint16_t *scratch = calloc((size_t)((2 * radius + 4 + CELL_PX) * values + 6 * radius + 1), 2);
    int16_t *gain = light_of(h * w), *light = light_of(h * values), *blurred = (int16_t *)room((size_t)h * values * 2);
    uint8_t *noise = room((size_t)h * values);
    const int count = render_pad_kinds(h, w, rays, change, 0, middles, strokes, rolling, regions, drawing[0], kinds, edges);
    float *shares = malloc((size_t)count * PAD_PAINTS * sizeof(float) + 1);
    float *parts = malloc((size_t)count * PAD_PAINTS * 9 * sizeof(float) + 1);
    render_pad_shares(h, w, rays, change, 0, 2, strokes, rolling, regions, drawing[0], 3, count, edges, shares, parts);
    render_expose(h * w, scene, kinds, gain, exposure, pad_scene, light);
    render_mix(count, edges, shares, scene, gain, exposure, pad_scene, light);
    for (int t = 0; t <= radius; t++) {
        taps[t] = (uint16_t)(65535 / (2 * radius + 1));
    }
    const int32_t window[4] = {0, 0, w, h}, reach = radius + 1;
    float *kernels = floats(5 * (2 * reach + 1), 0.1f);
    const int blocks = (w + LENS_BLOCK - 1) / LENS_BLOCK;
    float *blur_room = malloc((size_t)(4 * (LENS_BLOCK * blocks * (h + 1) + 2 * reach)) * sizeof(float));
    int32_t *places = malloc((size_t)(h * blocks * (LENS_BLOCK + 1)) * sizeof *places);
    int16_t *added = (int16_t *)room((size_t)h * values * 2);
    render_pad_lens(w, window, kinds, count, edges, shares, 3, parts, reach, kernels, kernels + 3 * (2 * reach + 1), scene, gain, exposure,
                    pad_scene, places, blur_room, added);
    fold_bytes(added, (size_t)h * values * 2);
    render_frame(h, w, light, radius, taps, window, rolling ? added : 0, radius % 2 ? noise : 0, codes, scratch, frame);
    fold_bytes(frame, (size_t)h * values), fold_bytes(kinds, (size_t)h * w);
    render_image(h, w, scene, rolling ? kinds : 0, gain, exposure, pad_scene, count, edges, shares, radius, taps, window, added,
                 radius % 2 ? noise : 0, codes, scratch, frame);
    fold_bytes(frame, (size_t)h * values);
    render_blur(h, w, light, radius, taps, window, added, scratch, blurred);
    fold_bytes(blurred, (size_t)h * values * 2);
    void *all[] = {rays, middles, strokes, kinds, frame, codes, edges, scene, pad_scene, taps, scratch, gain, light, noise, blurred, shares, parts,
                   kernels, blur_room, places, added};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

static void scenes(int count)
{
    const float scales[] = {1.0f, 30.0f, 1e3f, 1e5f};
    for (int i = 0; i < count; i++) {
        const int kind = fuzzed ? draw() : i;
        const int h = 2 * (2 + draw() % 20), w = 2 * (8 + draw() % 30);
        surface(h, w, scales[kind % 4], kind % 3);
        pad_in_light(h, w, 0.1f + 0.3f * (float)(kind % 7), kind % 2, kind % (BLUR_RADIUS_MAX / 4));
    }
}
