/* Publishers and subscribers in C, as the headers are shipped. Each is opened for as many steps as the scene wants. */
#include "checks.h"

#include "ex_msgs/msg/pair_shm.h"

typedef shm_ex_msgs_Pair pair;

/* --- opening ----------------------------------------------------------------------------------------------- */

static shmgen_type type_of_pair(void)
{
    shmgen_type type = shmgen_type_of_shm_ex_msgs_Pair();
    type.sequence = (uint32_t)told("sequence", 0);
    return type;
}

static shmgen_options options(void)
{
    return (shmgen_options){.depth = (uint32_t)told("depth", 1), .unstamped = 1};
}

/* How the region comes to be is explored only where the scene says so: opening=1. */
static bool is_quiet(uint32_t step)
{
    return quiet || (!told("opening", 0) && step < SHMGEN_STEP_LOCK);
}

/* In as few cycles as will do. */
static void wait_for(uint32_t step)
{
    pause_ms(step == SHMGEN_STEP_WATCH ? SHMGEN_CLAIM_MS : step == SHMGEN_STEP_CONFIRM ? SHMGEN_CONFIRM_MS : 3);
}

static shmgen_status begin_publisher(shmgen_publisher *publisher)
{
    const shmgen_type type = type_of_pair();
    const shmgen_options wanted = options();
    const bool was_quiet = quiet;
    shmgen_status status = shmgen_publisher_start(publisher, TOPIC, &type, &wanted);
    while (status == SHMGEN_OPENING) {
        const uint32_t step = publisher->end.step;
        settle();
        quiet = is_quiet(step);
        status = shmgen_publisher_step(publisher);
        settle();
        quiet = was_quiet;
        if (status == SHMGEN_OPENING && publisher->end.step == step)
            wait_for(step);
    }
    say("-- publisher: %s, last %u", shmgen_status_text(status), publisher->sequence);
    return status;
}

static shmgen_status open_publisher(shmgen_publisher *publisher)
{
    shmgen_status status = SHMGEN_OPENING;
    if (told("start", 0))
        pause_ms(told("start", 0));
    for (int64_t tries = told("tries", 1); tries > 0; tries--) {
        status = begin_publisher(publisher);
        if (status != SHMGEN_WRITER_IN_USE)
            break;
        pause_ms(100);
    }
    return status;
}

static shmgen_status open_subscriber(shmgen_subscriber *subscriber)
{
    const shmgen_type type = type_of_pair();
    const shmgen_options wanted = options();
    const bool was_quiet = quiet;
    shmgen_status status;
    if (told("start", 0) && !quiet)
        pause_ms(told("start", 0));
    status = shmgen_subscriber_start(subscriber, TOPIC, &type, &wanted);
    while (status == SHMGEN_OPENING) {
        const uint32_t step = subscriber->end.step;
        settle();
        quiet = is_quiet(step);
        status = shmgen_subscriber_step(subscriber);
        settle();
        quiet = was_quiet;
        if (status == SHMGEN_OPENING && subscriber->end.step == step)
            wait_for(step);
    }
    say("-- subscriber: %s, last %u", shmgen_status_text(status), subscriber->last);
    return status;
}

/* --- writers ----------------------------------------------------------------------------------------------- */

static shmgen_status publish(shmgen_publisher *publisher)
{
    const uint64_t content = new_content();
    const pair message = {content, content};
    shmgen_status status = shmgen_publisher_write(publisher, &message, sizeof message, told("lock_ms", 0) * MS);
    settle();
    if (status == SHMGEN_OK)
        published(publisher->sequence, content);
    else if (status == SHMGEN_CLAIM_LOST && stalls == 0)
        fail("STOLEN: %c lives, and has lost the topic", 'A' + self);
    else
        say("-- publish: %s", shmgen_status_text(status));
    return status;
}

/* n samples, one each `every` ms; cancel=1: none of them is completed; stays=1: does not close. */
static void writer(void)
{
    shmgen_publisher publisher;
    void *payload;
    if (open_publisher(&publisher) != SHMGEN_OK)
        return;
    for (int64_t n = told("n", 3); n > 0; n--) {
        if (told("cancel", 0)) {
            if (shmgen_publisher_begin(&publisher, 0, &payload) == SHMGEN_OK)
                shmgen_publisher_cancel(&publisher);
        } else if (publish(&publisher) == SHMGEN_CLAIM_LOST) {
            return;
        }
        if (told("every", 0))
            pause_ms(told("every", 0));
    }
    if (!told("stays", 0))
        shmgen_publisher_close(&publisher);
}

/* --- readers ----------------------------------------------------------------------------------------------- */

static shmgen_status read_one(shmgen_subscriber *subscriber, bool next)
{
    const int64_t lock = told("lock_ms", 0) * MS;
    pair message = {0, 0};
    shmgen_status status = next ? shmgen_subscriber_read_next(subscriber, &message, sizeof message, lock, NULL)
                                : shmgen_subscriber_read(subscriber, &message, sizeof message, lock, NULL);
    settle();
    if (status == SHMGEN_OK)
        received(subscriber->sequence, message.a, message.b);
    return status;
}

/* n looks, one each `every` ms; next=1: every sample that is still there. */
static void reader(void)
{
    shmgen_subscriber subscriber;
    uint32_t before;
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    before = subscriber.last;
    for (int64_t n = told("n", 3); n > 0; n--) {
        shmgen_status status = read_one(&subscriber, told("next", 0) != 0);
        if (status != SHMGEN_OK && status != SHMGEN_NOTHING_NEW && status != SHMGEN_OVERWRITTEN && status != SHMGEN_LOCK_TIMEOUT)
            fail("REFUSED: read says %s", shmgen_status_text(status));
        if (told("every", 0))
            pause_ms(told("every", 0));
    }
    if (subscriber.sequence != 0 &&
        shmgen_steps(&subscriber.end, before, subscriber.sequence) != received_by(self) + subscriber.missed)
        fail("MISCOUNTED: %u to %u, %u read, %u missed", before, subscriber.sequence, received_by(self), (unsigned)subscriber.missed);
}

/* Waits for each sample up to number n (leave=K: K), and is to have it `bound_us` after it is complete; all=1: each;
 * busy=MS: works so long after each, and loses some. */
static void waiter(void)
{
    const uint32_t last = (uint32_t)told("leave", told("n", 3));
    shmgen_subscriber subscriber;
    pair message = {0, 0};
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    while (!is_later(subscriber.sequence, last) && subscriber.sequence != last) {
        const uint32_t there = newest_published();
        shmgen_status status = shmgen_subscriber_wait(&subscriber, &message, sizeof message, 100 * MS, NULL);
        settle();
        if (status == SHMGEN_NOTHING_NEW) { /* its writer has died, or is late */
            if (is_later(there, subscriber.sequence))
                fail("LATE: sample %u was not there for 100 ms", there);
            if (!is_alive(0))
                return;
            continue;
        }
        if (status != SHMGEN_OK)
            fail("REFUSED: wait says %s", shmgen_status_text(status));
        received(subscriber.sequence, message.a, message.b);
        if (told("busy", 0)) {
            pause_ms(told("busy", 0));
            continue;
        }
        if (subscriber.missed != 0 && told("all", 0))
            fail("LOST: %c has missed %u", 'A' + self, (unsigned)subscriber.missed);
        if (since_published(subscriber.sequence) > told("bound_us", 0) * 1000)
            fail("LATE: sample %u after %.1f ms", subscriber.sequence, (double)since_published(subscriber.sequence) / MS);
    }
}

/* --- the lock alone ---------------------------------------------------------------------------------------- */

/* Holds it n times, for `hold` ms; tries each 600 ms. */
static void locker(void)
{
    enum { INSIDE = 24 };
    shmgen_subscriber subscriber;
    shmgen_link *end = &subscriber.end;
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    for (int64_t n = told("n", 2); n > 0; n--) {
        while (!shmgen_enter(end, told("lock_ms", 0) * MS))
            pause_ms(600);
        say("-- holds the lock");
        for (int other = 0; other < ACTORS; other++)
            if (other != self && known[INSIDE + other] && is_alive(other) && stalls == 0)
                fail("TWO INSIDE: %c and %c", 'A' + other, 'A' + self);
        known[INSIDE + self] = 1;
        if (told("hold", 0))
            pause_ms(told("hold", 0));
        else
            shmgen_store(end, SHMGEN_AT(missed), shmgen_load(end, SHMGEN_AT(missed)) + 1);
        settle();
        known[INSIDE + self] = 0;
        shmgen_leave(end);
    }
}

/* Has a region of its own layout (depth=D) open for `ms`, to write it (writes=1) or to read. It bears the name meanwhile, or
 * this end is told; where it is written, or only read by others (kept=1), nobody takes its name away. */
static void holder(void)
{
    const bool writes = told("writes", 0) != 0;
    shmgen_publisher publisher;
    shmgen_subscriber subscriber;
    shmgen_link *link = writes ? &publisher.end : &subscriber.end;
    if ((writes ? open_publisher(&publisher) : open_subscriber(&subscriber)) != SHMGEN_OK)
        return;
    for (int64_t left = told("ms", 30); left > 0; left -= 10) {
        const bool bears_the_name = shmgen_leads_to(link->name, link->file);
        const bool retired = shmgen_is_retired(link);
        settle();
        if (!bears_the_name && !retired)
            fail("ORPHAN: %c has a region without a name, and was not told", 'A' + self);
        if ((writes || told("kept", 0)) && retired && stalls == 0)
            fail("ROBBED: the region of %c was replaced, who lives", 'A' + self);
        pause_ms(10);
    }
    shmgen_link_close(link);
}

const end c_ends[] = {
    {"writer", writer}, {"reader", reader}, {"waiter", waiter}, {"locker", locker}, {"holder", holder}, {NULL, NULL}};

/* --- before and after -------------------------------------------------------------------------------------- */

static void c_was_here(int samples, uint32_t number)
{
    shmgen_publisher publisher;
    begin_publisher(&publisher);
    if (number != 0)
        publisher.sequence = number - (uint32_t)samples;
    while (samples-- > 0)
        publish(&publisher);
    close_all(self);
}

/* A region that is there, and what was written before by a C process (c_wrote=2, number=5: samples 4 and 5) or a PLC
 * (plc_wrote), which has stopped since; bare=1: nothing. */
void set_up(void)
{
    const uint32_t number = (uint32_t)told("number", 0);
    shmgen_subscriber subscriber;
    self = ACTORS - 1;
    set_up_calls();
    if (told("bare", 0))
        return;
    open_subscriber(&subscriber);
    shmgen_open_event(&subscriber.end);
    if (told("c_wrote", 0))
        c_was_here((int)told("c_wrote", 0), number);
    if (told("plc_wrote", 0))
        plc_was_here((int)told("plc_wrote", 0), number);
    close_all(self);
    self = 0;
}

/* Whoever died: a new reader finds the newest sample (unless may_hide=1), and the lock comes to one token. */
void look_after(void)
{
    shmgen_subscriber subscriber;
    pair message = {0, 0};
    shmgen_status status;
    bool nobody_died = true;
    int tokens;
    for (int actor = 0; actor < ACTORS; actor++)
        nobody_died = nobody_died && !has_crashed(actor);
    self = ACTORS - 1;
    status = open_subscriber(&subscriber);
    if (status != SHMGEN_OK) {
        fail("CLOSED: a new reader cannot open: %s", shmgen_status_text(status));
        return;
    }
    if (subscriber.end.lock != NULL) {
        tokens = shmgen_tokens(subscriber.end.lock);
        if (tokens > 1 && (stalls == 0 || told("one_token", 0)))
            fail("SURPLUS: the lock has %d tokens", tokens);
        if (tokens < 1 && nobody_died)
            fail("LOCKED: nobody died, and the lock is not free");
    }
    if (answers() < (uint64_t)told("answers", 0) && nobody_died && stalls == 0)
        fail("UNANSWERED: %u answers", (unsigned)answers());
    if (newest_published() == 0 && told("sends", 0))
        fail("UNSENT: nothing was published");
    if (newest_published() == 0)
        return;
    status = shmgen_subscriber_read(&subscriber, &message, sizeof message, 0, NULL);
    if (status != SHMGEN_OK && told("may_hide", 0))
        return;
    if (status != SHMGEN_OK)
        fail("HIDDEN: %u was published, a new reader gets: %s", newest_published(), shmgen_status_text(status));
    else if (is_later(newest_published(), subscriber.sequence) && !told("may_hide", 0))
        fail("HIDDEN: %u was published, a new reader gets %u", newest_published(), subscriber.sequence);
    else
        received(subscriber.sequence, message.a, message.b);
}
