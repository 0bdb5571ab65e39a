/* The name of a region: each length around the longest, with each ending that there may be, and none. */
#include "anything.h"

static shmgen_link end;

static void named(size_t letters, const char *ending)
{
    char topic[300];
    memset(topic, 'a', letters);
    memcpy(topic + letters, ending, strlen(ending) + 1);
    if (shmgen_name_region(&end, topic) == SHMGEN_OK) {
        size_t length = strlen(end.name);
        /*@ assert 2 <= length <= 249; */
    }
}

static void join_suffix(size_t letters)
{
    char name[320], joined[SHMGEN_JOINED_SIZE];
    memset(name, 'a', letters);
    name[letters] = 0;
    shmgen_join_name(joined, name, "-feedback");
    /*@ assert joined[SHMGEN_JOINED_SIZE - 1] == 0; */
}

int main(void)
{
    for (size_t letters = 286; letters < 300; letters++)
        join_suffix(letters);
    named(0, "");
    for (size_t letters = 234; letters < 248; letters++) {
        named(letters, "");
        named(letters, "-goal");
        named(letters, "-request");
        named(letters, "-feedback");
        named(letters, "/");
    }
}
