/* How many sub-rays pixels need on each side: `gpuspec/light/refinement.py` says why, and tells the same
   a second time. */
#include "portable.h"
#include "station.h"
#include "light_map.h"

/* Changes, in mm, below which few ask whether they are within the bound. */
#define QUIET 1e-3f

DEVICE int nearest_in(int place, int count) {
    return place < 0 ? 0 : place < count ? place : count - 1;
}

/* Entries of a plane from a place on; of places beyond its border, the nearest on it. */
DEVICE REAL entries(__global const float *plane, int row, int column, int rows, int columns,
                    int stride) {
    row = nearest_in(row, rows);
    __global const float *line = plane + (size_t)row * stride;
    if (column >= 0 && column + WIDTH <= columns) {
        return LOAD_ANYWHERE(line, column);
    }
    float found[WIDTH];
    for (int lane = 0; lane < WIDTH; lane++) {
        found[lane] = line[nearest_in(column + lane, columns)];
    }
    return LOAD_PRIVATE(found, 0);
}

/* A footprint's width, or where light is lost one that no neighbour has. */
DEVICE REAL width_of(REAL light, REAL wide) {
    REAL blind = BLIND_WIDTH;
    return light == 0.0f && wide == 1.0f ? blind : wide;
}

/* |l_cc| + |l_rr| + 2 |l_cr| over a pixel, or more: a neighbour's width less one's own. Differences for
   which the border lacks a neighbour are 0, and so is what is no pixel. */
DEVICE REAL changes(__global const float *light, __global const float *wide, int row, int column,
                    int rows, int columns, int stride) {
#define NEAR(plane, r, c) entries(plane, row + (r), column + (c), rows, columns, stride)
    REAL none = 0.0f;
    REAL place = (float)column + LANES;
    if (row < 0 || row >= rows) {
        return none;
    }
    REAL twice = 2.0f * NEAR(light, 0, 0);
    MASK across = place > 0.0f && place < (float)(columns - 1);
    REAL change = fabs(NEAR(light, 0, -1) - twice + NEAR(light, 0, 1));
    change = (across ? change : none);
    if (row > 0 && row < rows - 1) {
        change += fabs(NEAR(light, -1, 0) - twice + NEAR(light, 1, 0));
        REAL below = NEAR(light, 1, 1) - NEAR(light, 1, -1);
        REAL mixed = fabs(below - (NEAR(light, -1, 1) - NEAR(light, -1, -1)));
        change += 0.5f * (across ? mixed : none);
    }
#define WIDTH_AT(r, c) width_of(NEAR(light, r, c), NEAR(wide, r, c))
    REAL own = WIDTH_AT(0, 0);
    change = max(change, max(fabs(own - WIDTH_AT(0, -1)), fabs(own - WIDTH_AT(0, 1))));
    change = max(change, max(fabs(own - WIDTH_AT(-1, 0)), fabs(own - WIDTH_AT(1, 0))));
    return (place >= 0.0f && place < (float)columns ? change : none);
}

/* Sub-rays on each side: the least whose second differences are within the bound. */
DEVICE REAL sides_for(REAL change, REAL bound) {
    REAL most = 8.0f;
    REAL at_loss = AT_LOSS;
    REAL found = (change > 0.5f * BLIND_WIDTH ? at_loss : most);
    for (int n = 4; n >= 1; n /= 2) {
        REAL side = FLOAT(n);
        found = (change <= bound * FLOAT(n * n) ? side : found);
    }
    return found;
}

/* One work-item does a strip of pixels and some rows. */
__kernel void sides_needed(__global uchar *sides, __global const float *light,
                           __global const float *wide, int rows, int columns, int stride,
                           float bend, float width) {
    int left = (int)get_global_id(0) * STRIP_VECTORS * WIDTH;
    int top = (int)get_global_id(1) * STRIP_ROWS;
    int bottom = top + STRIP_ROWS < rows ? top + STRIP_ROWS : rows;
    REAL kept[3][STRIP_VECTORS + 2]; /* changes of three rows, with a vector more on each side */
    bool quiet[3];
    for (int row = top - 1; row <= bottom; row++) {
        int last = (row + 3) % 3;
        REAL most = 0.0f;
        for (int v = 0; v < STRIP_VECTORS + 2; v++) {
            kept[last][v] = changes(light, wide, row, left + (v - 1) * WIDTH, rows, columns, stride);
            most = max(most, kept[last][v]);
        }
        quiet[last] = !ANY(most > QUIET);
        if (row <= top) {
            continue;
        }
        bool still = quiet[0] && quiet[1] && quiet[2];
        for (int v = 0; v < STRIP_VECTORS && left + v * WIDTH < stride; v++) {
            size_t at = (size_t)(row - 1) * stride + left + v * WIDTH;
            REAL bound = bend * min(LOAD(wide, at), (REAL)width);
            REAL found = 1.0f;
            if (!still || ANY(bound < QUIET)) {
                REAL change = 0.0f;
                for (int i = 0; i < 3; i++) {
                    for (int shift = -1; shift <= 1; shift++) {
                        float *from = (float *)kept[i];
                        change = max(change, LOAD_PRIVATE(from, (v + 1) * WIDTH + shift));
                    }
                }
                found = sides_for(change, bound);
            }
            STORE_BYTE(found, sides, at);
        }
    }
}
