/* The light map of a list of pixels that a groove crosses each, in slices along it. */
#define SLICED
#include "listed.cl"
