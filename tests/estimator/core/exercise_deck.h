/* The deck from above from random places, and cells of a paint in random light, each array exactly as long as it must be. */

static void draw_from_above(int kind)
{
    const int nodes = 2 + draw() % 5, between = 1 + draw() % 6, channels = kind % 2 ? 1 : 3, n = (nodes - 1) * between + 1;
    const frame_part all = {0, 0, 0, 4 + draw() % 40, 4 + draw() % 30};
    int32_t stride;
    uint8_t *px = part_pixels(&all, &stride), *out = room((size_t)(channels * n * n)), *shown = room((size_t)(n * n));
    float *places = malloc(2 * sizeof *places * (size_t)(nodes * nodes));
    for (int i = 0; i < nodes * nodes; i++) {
        double at[2] = {all.width * (0.5 + uniform()), all.height * (0.5 + uniform())};
        poisoned(at, 2);
        places[2 * i] = (float)at[0], places[2 * i + 1] = (float)at[1];
    }
    const dl_image image = {all.width, all.height, stride, 3, px};
    if (dl_from_above(&image, places, nodes, between, channels, out, shown) == n) {
        fold_bytes(out, (size_t)(channels * n * n)), fold_bytes(shown, (size_t)(n * n));
    }
    free(px), free(out), free(shown), free(places);
}

static void read_paint(void)
{
    const int n = 1 + draw() % 60;
    float *numbers = malloc(sizeof *numbers * (size_t)(10 * n + 3));
    for (int i = 0; i < 10 * n + 3; i++) {
        double one = i < 2 * n ? uniform() : 0.5 + 0.5 * uniform();
        poisoned(&one, 1);
        numbers[i] = (float)one;
    }
    float *out = numbers + 5 * n + 3;
    dl_paint_rest(numbers + 2 * n, numbers, n, numbers + 5 * n, out, numbers + 8 * n + 3);
    for (int i = 0; i < 3 * n; i++) {
        const double one = out[i];
        fold(&one, 1);
    }
    free(numbers);
}

static void decks(int count)
{
    for (int i = 0; i < count; i++) {
        draw_from_above(fuzzed ? draw() : i);
        read_paint();
    }
}
