/* How a light map lies in a texture: sub-ray after sub-ray, row after row of the tile, each row cut
   into WRAPS lines where it is wider than the largest texture. */
uniform int first_row; /* of the tile in the image */
uniform int rows;      /* of the tile */
#ifdef ONE_RAY
const int sub_rays = 1;
#else
uniform int sub_rays;
#endif

/* The fragment's texel; floats count them exactly. */
ivec2 texel() {
    return ivec2(gl_FragCoord.xy);
}

#ifdef LISTED
uniform isampler2D pixels; /* numbered row by row through the image, LIST_WIDTH in a row */
uniform int line_length;   /* pixels of a list in a row of the tile */
uniform int image_columns;
#endif

/* The pixel of the whole image that a texel belongs to; `width` is the texture's. */
ivec2 pixel_of(ivec2 at, int width) {
    int line = at.y % (rows * WRAPS);
    ivec2 place = ivec2(at.x + (line % WRAPS) * width, first_row + line / WRAPS);
#ifdef LISTED
    int nth = place.y * line_length + place.x;
    int number = texelFetch(pixels, ivec2(nth % LIST_WIDTH, nth / LIST_WIDTH), 0).x;
    place = ivec2(number % image_columns, number / image_columns);
#endif
    return place;
}
