/* The same of a list of pixels. */
#define POSED
#include "listed.cl"
