/* The light map of a list of pixels, which may lie anywhere in the image. */
#define LISTED
#if WIDTH > 1
#define MIXED_BLOCKS
#endif
#include "trace.cl"
