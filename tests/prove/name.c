/* The name of a region: all lengths near the limit, with each suffix of services and actions, and without a suffix. */
#include "environment.h"

static shmgen_link region_link;

static void check_region_name(size_t length, const char *suffix)
{
    char topic[300];
    memset(topic, 'a', length);
    memcpy(topic + length, suffix, strlen(suffix) + 1);
    if (shmgen_name_region(&region_link, topic) == SHMGEN_OK) {
        size_t name_length = strlen(region_link.name);
        /*@ assert 2 <= name_length <= 249; */
    }
}

static void check_joined_name(size_t length)
{
    char name[320], joined_name[SHMGEN_JOINED_SIZE];
    memset(name, 'a', length);
    name[length] = 0;
    shmgen_join_name(joined_name, name, "-feedback");
    /*@ assert joined_name[SHMGEN_JOINED_SIZE - 1] == 0; */
}

int main(void)
{
    for (size_t length = 286; length < 300; length++)
        check_joined_name(length);
    check_region_name(0, "");
    for (size_t length = 234; length < 248; length++) {
        check_region_name(length, "");
        check_region_name(length, "-goal");
        check_region_name(length, "-request");
        check_region_name(length, "-feedback");
        check_region_name(length, "/");
    }
}
