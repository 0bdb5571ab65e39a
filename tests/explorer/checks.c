/* The checks of samples and calls. Their values in `check_values` are part of the state. */
#include "checks.h"

enum { CONTENTS = 32, CALLS = 16 };
/* Indexes of `check_values`; endpoints.c uses 24 to 31 for the lockers, and litmus.c uses 150 and 151. */
enum { WRITTEN, NEWEST, ANSWERED, LAST = 8, COUNT = 16, TIME = 32, CONTENT = TIME + CONTENTS, SERVED = CONTENT + CONTENTS };

uint64_t new_content(void)
{
    return 100 + ++check_values[WRITTEN];
}

bool is_later(uint32_t number, uint32_t than)
{
    return number != 0 && (than == 0 || (int32_t)(number - than) > 0);
}

void note_published(uint32_t number, uint64_t content)
{
    if (check_values[CONTENT + number % CONTENTS] != 0 && check_values[CONTENT + number % CONTENTS] != content)
        fail("TWO: sample %u is %u, and %u", number, (unsigned)check_values[CONTENT + number % CONTENTS], (unsigned)content);
    if (is_later(number, (uint32_t)check_values[NEWEST]))
        check_values[NEWEST] = number;
    check_values[TIME + number % CONTENTS] = (uint64_t)now;
    check_values[CONTENT + number % CONTENTS] = content;
    trace("-- has published %u (%u)", number, (unsigned)content);
}

void check_sample(uint32_t number, uint64_t a, uint64_t b)
{
    uint64_t *content = &check_values[CONTENT + number % CONTENTS];
    trace("-- has read %u (%u, %u)", number, (unsigned)a, (unsigned)b);
    if (a != b)
        fail("TORN: sample %u is %u and %u", number, (unsigned)a, (unsigned)b);
    if (a == 0)
        fail("UNWRITTEN: sample %u", number);
    if (*content != 0 && *content != a)
        fail("TWO: sample %u is %u, and %u", number, (unsigned)*content, (unsigned)a);
    if (check_values[LAST + self] != 0 && !is_later(number, (uint32_t)check_values[LAST + self]))
        fail("BACK: sample %u after %u", number, (unsigned)check_values[LAST + self]);
    *content = a;
    check_values[LAST + self] = number;
    check_values[COUNT + self]++;
}

uint32_t newest_published(void)
{
    return (uint32_t)check_values[NEWEST];
}

int64_t since_published(uint32_t number)
{
    const int64_t when = (int64_t)check_values[TIME + number % CONTENTS];
    return when != 0 ? now - when : 0;
}

uint32_t received_by(int actor)
{
    return (uint32_t)check_values[COUNT + actor];
}

uint64_t new_request(void)
{
    const uint64_t request = new_content();
    trace("-- sends request %u", (unsigned)request);
    return request;
}

uint64_t take_request(uint64_t a, uint64_t b)
{
    uint64_t *served = &check_values[SERVED + a % CALLS];
    trace("-- takes request %u", (unsigned)a);
    if (a != b)
        fail("TORN: a request is %u and %u", (unsigned)a, (unsigned)b);
    if (*served == a)
        fail("AGAIN: request %u is served twice", (unsigned)a);
    *served = a;
    return a + 1000;
}

void check_response(uint64_t request, uint64_t a, uint64_t b)
{
    trace("-- receives response %u", (unsigned)a);
    if (a != b)
        fail("TORN: a response is %u and %u", (unsigned)a, (unsigned)b);
    if (a != request + 1000)
        fail("OTHER: request %u gets the response %u", (unsigned)request, (unsigned)a);
    check_values[ANSWERED]++;
}

uint64_t response_count(void)
{
    return check_values[ANSWERED];
}
