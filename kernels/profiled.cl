/* The images of `sequence.cl` lit by a profile that is no stripes. */
#define PROFILE
#include "sequence.cl"
