/* UVLC pictures: made of random images, read whole, cut and damaged, and random bytes that begin as a picture does. */

static void read_picture(const uint8_t *bytes, int size)
{
    uint8_t *data = malloc((size_t)(size > 0 ? size : 1));
    memcpy(data, bytes, (size_t)size);
    dl_uvlc_picture picture;
    const int known = dl_uvlc_header(data, size, &picture);
    found += known;
    if (known == DL_UVLC_DONE) {
        const size_t pixels = (size_t)(3 * picture.width * picture.height);
        uint8_t *bgr = calloc(pixels, 1);
        if (dl_uvlc_decode(data, size, &picture, bgr, (int32_t)pixels) == DL_UVLC_DONE) {
            fold_bytes(bgr, pixels);
        }
        free(bgr);
    }
    free(data);
}

static void video(int count)
{
    static const int SIZES[][2] = {{176, 144}, {320, 240}, {352, 288}, {176, 120}};
    for (int k = 0; k < count; k++) {
        const int *size = SIZES[draw() % 4], room = draw() % 4 ? 65504 : draw() % 2000;
        dl_sim_uvlc_picture picture = {size[0], size[1], draw() % 33, draw()};
        const size_t pixels = (size_t)(3 * size[0] * size[1]);
        uint8_t *bgr = malloc(pixels), *out = calloc((size_t)room + 1, 1);
        const int rough = 1 + draw() % 255;
        for (size_t i = 0; i < pixels; i++) {
            bgr[i] = (uint8_t)(next_random() % rough);
        }
        const int bytes = dl_sim_uvlc_encode(bgr, (int32_t)pixels, &picture, out, room);
        found += bytes;
        if (bytes > 0) {
            read_picture(out, bytes);
            read_picture(out, draw() % bytes);
            for (int damage = 1 + draw() % 8; damage > 0; damage--) {
                out[draw() % bytes] ^= (uint8_t)(1 << draw() % 8);
            }
            read_picture(out, bytes);
        }
        free(bgr), free(out);
        /* A start code, 176x144 px, intra, quantizer 31. */
        uint8_t drawn[400] = {0x43, 0x81, 0, 0, 0, 0, 0, 0xE0};
        for (int i = 8; i < (int)sizeof drawn; i++) {
            drawn[i] = (uint8_t)draw();
        }
        read_picture(drawn, draw() % (int)sizeof drawn);
    }
}
