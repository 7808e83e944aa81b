/* All thresholds at once: a pixel's level is the number of those it is above. */
#ifndef LEVEL_H
#define LEVEL_H

/* Level of a grey level: of the 256 thresholds, 1 / `per_dn` apart from 0 on, how many it is above.
   With 8 bits per pixel they are the whole grey levels, `per_dn` is 1. A level is the place of a
   counter: what rounding puts above the last is the last, and what is no number is 0. */
DEVICE REAL level_of(REAL grey, float per_dn) {
    REAL level = -floor(-per_dn * grey);
    REAL none = 0.0f, last = LEVELS - 1.0f;
    level = (level > 0.0f ? level : none);
    return level < last ? level : last;
}

#endif
