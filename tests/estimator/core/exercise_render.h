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
    const int columns = (w + DL_CELL_PX - 1) / DL_CELL_PX + 2, rows = (h + DL_CELL_PX - 1) / DL_CELL_PX + 2, tile = 16;
    float *cells = floats(2 * rows * columns, scale), *slow = floats(2 * (rows / 2 + 1) * (columns / 2 + 1), 300.0f);
    float *near = floats(2 * rows * columns, 1.0f);
    int16_t *gain = light_of(h * w);
    int16_t *texels = room((size_t)(tile + 1) * (tile + 1) * 2);
    uint16_t *scene = room((size_t)h * w * 8), *drawing = room(8 * 20 * 30), *smeared = room((size_t)h * w * 8);
    uint8_t *mask = room((size_t)h * w), *codes = room((size_t)h * w / 4), *colour = room(256 * 8);
    const int32_t shifts[6] = {-3, 2, 0, 0, 3, -2};
    const int32_t apart[4] = {-draw() % 40, 3, draw() % 40, -draw() % 5};
    const uint16_t weights[3] = {20000, 25535, 20000};
    const dl_sim_drone_shade shade = {0.14f, 0.115f, 0.2f, 0.05f, 0.02f, 0.45f};
    const double outlines[14] = {-9.0, -4.0, 9.0, -4.0, 9.0, 4.0, -9.0, 4.0, 1.0, 1.0, 3.0, 7.0, 6.0, 1.0};
    int32_t part[8];
    const double turn[9] = {0.9, 0.1, 0.0, -0.1, 0.9, 0.05, 0.0, 0.02, 1.0};
    const dl_sim_wave waves[2] = {{0.4, {0.3, 0.1}, 1.2, 0.5}, {1.0, {-0.05, 0.2}, 0.8, 2.0}};
    const dl_sim_frame_part all_of = {w, 0, w, 0, h}, inner = {w, 1, w - 1, 1, h - 1}, squares = {w, 0, w / 2, 0, h / 2};
    const dl_sim_plane_cells met = {cells, columns}, met_near = {near, columns};
    const dl_sim_drawing drawn = {drawing, 20, 30};
    const dl_sim_sea_surface sea = {
        {texels, tile, 0.3, 1e3, -1e3}, {texels, tile, 2.0, 0.1, 0.2}, {texels, tile, 1.0, 0.0, 0.0}, {texels, tile, 4.0, -0.5, 0.5},
        {0.5f, 0.8f, 1.0f, 120.0f, 0.5f, 110.0f, 130.0f}, slow, outlines, {with_mask ? 4 : 0, 3, 0}, {0.4f, 0.5f, 1.2f}};
    dl_sim_swell swell = {{0.0}, {0.0}, {0.3, 0.4, -0.86}, 3.0, waves, with_mask ? 2 : 0};
    memcpy(swell.R_ned_cam, turn, sizeof turn), memcpy(swell.plane_from_ray, turn, sizeof turn);
    dl_sim_render_deck(&inner, &met, &drawn, with_mask ? mask : 0, scene);
    dl_sim_render_fill(&all_of, mask, (const uint16_t *)colour, scene);
    dl_sim_render_smear(h, w, scene, 3, shifts, weights, smeared);
    fold_bytes(smeared, (size_t)h * w * 8);
    dl_sim_render_average(h, w, scene, apart, smeared);
    dl_sim_render_sea(h, &squares, &met, &sea, with_mask ? mask : 0, codes);
    dl_sim_render_shadow(h, w, &met_near, &shade, with_mask ? mask : 0, gain, part);
    dl_sim_render_bounds(h, w, mask, part, part + 4);
    fold_bytes(part, sizeof part);
    dl_sim_render_meet(rows * columns, cells, turn, 1e5, near);
    fold_bytes(near, sizeof(float) * 2 * (size_t)(rows * columns));
    fold_bytes(gain, (size_t)h * w * 2), fold_bytes(codes, (size_t)h * w / 4);
    dl_sim_render_swell(rows, columns, cells, &swell, slow);
    dl_sim_render_water(&all_of, codes, (const uint16_t *)colour, with_mask ? mask : 0, scene);
    fold_bytes(scene, (size_t)h * w * 8), fold_bytes(smeared, (size_t)h * w * 8), fold_bytes(codes, (size_t)h * w / 4);
    void *all[] = {cells, slow, near, gain, texels, scene, drawing, smeared, mask, codes, colour};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        free(all[i]);
    }
}

static void pad_in_light(int h, int w, float height_m, int rolling, int radius)
{
    const float drawing[][DL_PAD_REGION] = {
        {DL_PAD_ANNULUS, DL_PAD_DISC, DL_PAD_NONE, 0.0f, 0.38f, -1.0f, 0.38f},
        {DL_PAD_ANNULUS, DL_PAD_RIM, DL_PAD_NONE, 0.38f, 0.39f, 0.38f, 0.39f},
        {DL_PAD_ANNULUS, DL_PAD_ORANGE, DL_PAD_DISC, 0.243f, 0.261f, 0.243f, 0.261f},
        {DL_PAD_ARROW, DL_PAD_ORANGE, DL_PAD_DISC, 0.252f, 0.3f, 0.3f, 0.252f, 0.7071f, 0.7071f},
        {DL_PAD_RECTANGLE, DL_PAD_WHITE, DL_PAD_DISC, 0.06f, 0.1721f, -0.14f, 0.14f, -0.1f, -0.06f},
        {DL_PAD_RECTANGLE, DL_PAD_WHITE, DL_PAD_DISC, 0.06f, 0.1721f, -0.14f, 0.14f, 0.06f, 0.1f},
        {DL_PAD_RECTANGLE, DL_PAD_WHITE, DL_PAD_DISC, 0.0f, 0.0633f, -0.02f, 0.02f, -0.06f, 0.06f},
        {DL_PAD_POLYGON, DL_PAD_UPPER, DL_PAD_WHITE, 0.0f, 0.015f, 4, 0.7071f, 0.7071f, 0.0106f, -0.7071f, 0.7071f, 0.0106f, -0.7071f, -0.7071f,
         0.0106f, 0.7071f, -0.7071f, 0.0106f},
    };
    const int32_t regions = sizeof drawing / sizeof *drawing;
    const float change[4] = {1.0f / 100.0f, 0.0f, 0.0f, 1.0f / 100.0f}, exposure[4] = {0.2f, 0.2f, 0.2f, 0.0f};
    const int squares = (w + DL_CELL_PX - 1) / DL_CELL_PX + 2, square_rows = (h + DL_CELL_PX - 1) / DL_CELL_PX + 2;
    float *middles = malloc((size_t)squares * square_rows * 2 * sizeof(float));
    for (int i = 0; i < squares * square_rows; i++) {
        middles[2 * i] = ((float)(DL_CELL_PX * (i % squares - 1)) + 3.5f - 0.5f * (float)w) * change[0];
        middles[2 * i + 1] = ((float)(DL_CELL_PX * (i / squares - 1)) + 3.5f - 0.5f * (float)h) * change[3];
    }
    float *rays = malloc((size_t)h * w * 2 * sizeof(float)), *strokes = floats(2 * DL_STROKE_NUMBERS, 0.02f);
    for (int i = 0; i < h * w; i++) {
        rays[2 * i] = ((float)(i % w) - 0.5f * (float)w) * change[0];
        rays[2 * i + 1] = ((float)(i / w) - 0.5f * (float)h) * change[3];
    }
    for (int part = 0; part < 2 * DL_STROKE_NUMBERS; part += 9) {
        const float sign = part % DL_STROKE_NUMBERS == 9 ? 0.05f : 1.0f;
        strokes[part] += sign;
        strokes[part + 4] += sign;
        strokes[part + 8] += sign / height_m;
    }
    const int values = 3 * w;
    uint8_t *kinds = room((size_t)h * w), *frame = room((size_t)h * values), *codes = room(65536);
    int32_t *edges = room((size_t)h * w * 4);
    uint16_t *scene = room((size_t)h * w * 8), *pad_scene = room(DL_PAD_PAINTS * 8), *taps = room(62);
    const int32_t numbers_of = (2 * radius + 3 + DL_CELL_PX) * values + w + 2 * radius;
    uint16_t *scratch = calloc((size_t)numbers_of, 2);
    int16_t *gain = light_of(h * w), *light = light_of(h * values), *blurred = (int16_t *)room((size_t)h * values * 2);
    uint8_t *noise = room((size_t)h * values);
    const dl_sim_pad_view view = {h, w, 0, rolling, regions, rays, change, middles, drawing[0]};
    const int count = dl_sim_render_pad_kinds(&view, strokes, kinds, edges);
    float *shares = malloc((size_t)count * DL_PAD_PAINTS * sizeof(float) + 1);
    float *parts = malloc((size_t)count * DL_PAD_PAINTS * 9 * sizeof(float) + 1);
    dl_sim_render_pad_shares(&view, 2, strokes, 3, count, edges, shares, parts);
    dl_sim_lit_scene seen = {h, w, count, 3, scene, kinds, gain, exposure, pad_scene, edges, shares, parts};
    dl_sim_render_expose(&seen, light);
    dl_sim_render_mix(&seen, light);
    for (int t = 0; t <= radius; t++) {
        taps[t] = (uint16_t)(65535 / (2 * radius + 1));
    }
    const int32_t window[4] = {0, 0, w, h}, reach = radius + 1;
    float *kernels = floats(5 * (2 * reach + 1), 0.1f);
    const int blocks = (w + DL_LENS_BLOCK - 1) / DL_LENS_BLOCK;
    const int32_t floats_of = 4 * (DL_LENS_BLOCK * blocks * (h + 1) + 2 * reach), places_of = h * blocks * (DL_LENS_BLOCK + 1);
    float *blur_room = malloc((size_t)floats_of * sizeof(float));
    int32_t *places = malloc((size_t)places_of * sizeof *places);
    int16_t *added = (int16_t *)room((size_t)h * values * 2);
    const dl_sim_lens_kernels lens = {reach, floats_of, places_of, kernels, kernels + 3 * (2 * reach + 1), blur_room, places};
    dl_sim_lens_kernels narrow = lens;
    narrow.floats--;
    found += dl_sim_render_pad_lens(&seen, window, &narrow, added) + dl_sim_render_pad_lens(&seen, window, &lens, added);
    fold_bytes(added, (size_t)h * values * 2);
    const dl_sim_sensor_tone tone = {radius % 2 ? noise : 0, codes};
    dl_sim_lens_blur blur = {radius, numbers_of - 1, taps, window, rolling ? added : 0, scratch};
    found += dl_sim_render_frame(h, w, light, &blur, &tone, frame);
    blur.numbers++;
    found += dl_sim_render_frame(h, w, light, &blur, &tone, frame);
    fold_bytes(frame, (size_t)h * values), fold_bytes(kinds, (size_t)h * w);
    seen.kinds = rolling ? kinds : 0, blur.added = added;
    dl_sim_render_image(&seen, &blur, &tone, frame);
    fold_bytes(frame, (size_t)h * values);
    dl_sim_render_blur(h, w, light, &blur, blurred);
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
        pad_in_light(h, w, 0.1f + 0.3f * (float)(kind % 7), kind % 2, kind % (DL_BLUR_RADIUS_MAX / 4));
    }
}
