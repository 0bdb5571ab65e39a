#include "explorer.h"
const end call_ends[] = {{NULL, NULL}};
