/* What must hold, and what is known of it: part of the state. */
#include "checks.h"

enum { CONTENTS = 32, CALLS = 16 };
/* Places in `known`; the lockers of ends.c have 24 to 31, litmus.c those from 150 on. */
enum { WRITTEN, NEWEST, ANSWERED, LAST = 8, COUNT = 16, TIME = 32, CONTENT = TIME + CONTENTS, SERVED = CONTENT + CONTENTS };

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
    if (known[CONTENT + number % CONTENTS] != 0 && known[CONTENT + number % CONTENTS] != content)
        fail("TWO: sample %u is %u, and %u", number, (unsigned)known[CONTENT + number % CONTENTS], (unsigned)content);
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

uint64_t new_question(void)
{
    const uint64_t question = new_content();
    say("-- asks %u", (unsigned)question);
    return question;
}

uint64_t taken(uint64_t a, uint64_t b)
{
    uint64_t *served = &known[SERVED + a % CALLS];
    say("-- is asked %u", (unsigned)a);
    if (a != b)
        fail("TORN: a question is %u and %u", (unsigned)a, (unsigned)b);
    if (*served == a)
        fail("AGAIN: question %u is served twice", (unsigned)a);
    *served = a;
    return a + 1000;
}

void answered(uint64_t question, uint64_t a, uint64_t b)
{
    say("-- is answered %u", (unsigned)a);
    if (a != b)
        fail("TORN: an answer is %u and %u", (unsigned)a, (unsigned)b);
    if (a != question + 1000)
        fail("OTHER: question %u is answered with %u", (unsigned)question, (unsigned)a);
    known[ANSWERED]++;
}

uint64_t answers(void)
{
    return known[ANSWERED];
}
