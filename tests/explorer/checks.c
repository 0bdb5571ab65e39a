#include "checks.h"

enum { WRITTEN, NEWEST, LAST = 8, COUNT = LAST + ACTORS + 1, TIME = 32, CONTENT = TIME + 32, CONTENTS = 32 };

uint64_t new_content(void)
{
    return 100 + ++known[WRITTEN];
}

bool is_later(uint32_t number, uint32_t than)
{
    return number != 0 && (than == 0 || (int32_t)(number - than) > 0);
}

void published(uint32_t number, uint64_t content)
{
    if (is_later(number, (uint32_t)known[NEWEST]))
        known[NEWEST] = number;
    known[TIME + number % CONTENTS] = (uint64_t)now;
    known[CONTENT + number % CONTENTS] = content;
    say("-- has published %u (%u)", number, (unsigned)content);
}

void received(uint32_t number, uint64_t a, uint64_t b)
{
    uint64_t *content = &known[CONTENT + number % CONTENTS];
    say("-- has read %u (%u, %u)", number, (unsigned)a, (unsigned)b);
    if (a != b)
        fail("TORN: sample %u is %u and %u", number, (unsigned)a, (unsigned)b);
    if (a == 0)
        fail("UNWRITTEN: sample %u", number);
    if (*content != 0 && *content != a)
        fail("TWO: sample %u is %u, and %u", number, (unsigned)*content, (unsigned)a);
    if (known[LAST + self] != 0 && !is_later(number, (uint32_t)known[LAST + self]))
        fail("BACK: sample %u after %u", number, (unsigned)known[LAST + self]);
    *content = a;
    known[LAST + self] = number;
    known[COUNT + self]++;
}

uint32_t newest_published(void)
{
    return (uint32_t)known[NEWEST];
}

int64_t since_published(uint32_t number)
{
    const int64_t when = (int64_t)known[TIME + number % CONTENTS];
    return when != 0 ? now - when : 0;
}

uint32_t received_by(int actor)
{
    return (uint32_t)known[COUNT + actor];
}
