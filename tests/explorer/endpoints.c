/* The endpoints of a topic that use the shipped C headers. */
#include "checks.h"

#include "ex_msgs/msg/pair_shm.h"

typedef shm_ex_msgs_Pair pair;

/* --- opening ----------------------------------------------------------------------------------------------- */

static shmgen_type type_of_pair(void)
{
    shmgen_type type = shmgen_type_of_shm_ex_msgs_Pair();
    type.sequence = (uint32_t)setting("sequence", 0);
    return type;
}

static shmgen_options options(void)
{
    return (shmgen_options){.depth = (uint32_t)setting("depth", 1), .unstamped = 1};
}

/* Return true if the calls that open a region are not steps. They are steps only if opening=1 is set. */
static bool opens_without_steps(uint32_t step)
{
    return without_steps || (!setting("opening", 0) && step < SHMGEN_STEP_LOCK);
}

/* Wait for the next cycle of opening. The wait is long, so that opening takes few cycles. */
static void wait_for(uint32_t step)
{
    pause_ms(step == SHMGEN_STEP_WATCH ? SHMGEN_CLAIM_MS : step == SHMGEN_STEP_CONFIRM ? SHMGEN_CONFIRM_MS : 3);
}

static shmgen_status try_open_publisher(shmgen_publisher *publisher)
{
    const shmgen_type type = type_of_pair();
    const shmgen_options region_options = options();
    const bool was_without_steps = without_steps;
    shmgen_status status = shmgen_publisher_start(publisher, TOPIC, &type, &region_options);
    while (status == SHMGEN_OPENING) {
        const uint32_t step = publisher->end.step;
        finish_access();
        without_steps = opens_without_steps(step);
        status = shmgen_publisher_step(publisher);
        finish_access();
        without_steps = was_without_steps;
        if (status == SHMGEN_OPENING && publisher->end.step == step)
            wait_for(step);
    }
    trace("-- publisher: %s, last %u", shmgen_status_text(status), publisher->sequence);
    return status;
}

static shmgen_status open_publisher(shmgen_publisher *publisher)
{
    shmgen_status status = SHMGEN_OPENING;
    if (setting("start", 0))
        pause_ms(setting("start", 0));
    for (int64_t tries = setting("tries", 1); tries > 0; tries--) {
        status = try_open_publisher(publisher);
        if (status != SHMGEN_WRITER_IN_USE)
            break;
        pause_ms(100);
    }
    return status;
}

static shmgen_status open_subscriber(shmgen_subscriber *subscriber)
{
    const shmgen_type type = type_of_pair();
    const shmgen_options region_options = options();
    const bool was_without_steps = without_steps;
    shmgen_status status;
    if (setting("start", 0) && !without_steps)
        pause_ms(setting("start", 0));
    status = shmgen_subscriber_start(subscriber, TOPIC, &type, &region_options);
    while (status == SHMGEN_OPENING) {
        const uint32_t step = subscriber->end.step;
        finish_access();
        without_steps = opens_without_steps(step);
        status = shmgen_subscriber_step(subscriber);
        finish_access();
        without_steps = was_without_steps;
        if (status == SHMGEN_OPENING && subscriber->end.step == step)
            wait_for(step);
    }
    trace("-- subscriber: %s, last %u", shmgen_status_text(status), subscriber->last);
    return status;
}

/* --- writers ----------------------------------------------------------------------------------------------- */

static shmgen_status publish(shmgen_publisher *publisher)
{
    const uint64_t content = new_content();
    const pair message = {content, content};
    shmgen_status status = shmgen_publisher_write(publisher, &message, sizeof message, setting("lock_ms", 0) * MS);
    finish_access();
    if (status == SHMGEN_OK)
        note_published(publisher->sequence, content);
    else if (status == SHMGEN_CLAIM_LOST && stalls == 0)
        fail("STOLEN: %c lost the topic without a stall", 'A' + self);
    else
        trace("-- publish: %s", shmgen_status_text(status));
    return status;
}

/* Write n samples, one every `every` ms. cancel=1: cancel each sample. stays=1: do not close the publisher. */
static void writer(void)
{
    shmgen_publisher publisher;
    void *payload;
    if (open_publisher(&publisher) != SHMGEN_OK)
        return;
    for (int64_t n = setting("n", 3); n > 0; n--) {
        if (setting("cancel", 0)) {
            if (shmgen_publisher_begin(&publisher, 0, &payload) == SHMGEN_OK)
                shmgen_publisher_cancel(&publisher);
        } else if (publish(&publisher) == SHMGEN_CLAIM_LOST) {
            return;
        }
        if (setting("every", 0))
            pause_ms(setting("every", 0));
    }
    if (!setting("stays", 0))
        shmgen_publisher_close(&publisher);
}

/* --- readers ----------------------------------------------------------------------------------------------- */

static shmgen_status read_one(shmgen_subscriber *subscriber, bool next)
{
    const int64_t lock = setting("lock_ms", 0) * MS;
    pair message = {0, 0};
    shmgen_status status = next ? shmgen_subscriber_read_next(subscriber, &message, sizeof message, lock, NULL)
                                : shmgen_subscriber_read(subscriber, &message, sizeof message, lock, NULL);
    finish_access();
    if (status == SHMGEN_OK)
        check_sample(subscriber->sequence, message.a, message.b);
    return status;
}

/* Read n times, once every `every` ms. next=1: read every sample that is still in the region. */
static void reader(void)
{
    shmgen_subscriber subscriber;
    uint32_t before;
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    before = subscriber.last;
    for (int64_t n = setting("n", 3); n > 0; n--) {
        shmgen_status status = read_one(&subscriber, setting("next", 0) != 0);
        if (status != SHMGEN_OK && status != SHMGEN_NOTHING_NEW && status != SHMGEN_OVERWRITTEN && status != SHMGEN_LOCK_TIMEOUT)
            fail("REFUSED: read returns %s", shmgen_status_text(status));
        if (setting("every", 0))
            pause_ms(setting("every", 0));
    }
    if (subscriber.sequence != 0 &&
        shmgen_steps(&subscriber.end, before, subscriber.sequence) != received_by(self) + subscriber.missed)
        fail("MISCOUNTED: %u to %u, %u read, %u missed", before, subscriber.sequence, received_by(self), (unsigned)subscriber.missed);
}

/* Wait for samples up to number n (until=K: up to K). Each sample must arrive within `bound_us` us after its completion.
 * all=1: no sample may be missed. busy=MS: pause after each sample, so samples may arrive late or be missed. */
static void waiter(void)
{
    const uint32_t last = (uint32_t)setting("until", setting("n", 3));
    shmgen_subscriber subscriber;
    pair message = {0, 0};
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    while (!is_later(subscriber.sequence, last) && subscriber.sequence != last) {
        const uint32_t newest = newest_published();
        shmgen_status status = shmgen_subscriber_wait(&subscriber, &message, sizeof message, 100 * MS, NULL);
        finish_access();
        if (status == SHMGEN_NOTHING_NEW) { /* the writer has crashed, or pauses */
            if (is_later(newest, subscriber.sequence))
                fail("LATE: sample %u has not arrived within 100 ms", newest);
            if (!is_alive(0))
                return;
            continue;
        }
        if (status != SHMGEN_OK)
            fail("REFUSED: wait returns %s", shmgen_status_text(status));
        check_sample(subscriber.sequence, message.a, message.b);
        if (setting("busy", 0)) {
            pause_ms(setting("busy", 0));
            continue;
        }
        if (subscriber.missed != 0 && setting("all", 0))
            fail("LOST: %c has missed %u samples", 'A' + self, (unsigned)subscriber.missed);
        if (since_published(subscriber.sequence) > setting("bound_us", 0) * 1000)
            fail("LATE: sample %u arrived after %.1f ms", subscriber.sequence, (double)since_published(subscriber.sequence) / MS);
    }
}

/* --- only the lock ----------------------------------------------------------------------------------------- */

/* Acquire the lock n times, and hold it for `hold` ms. If the lock is not free, retry after 600 ms. */
static void locker(void)
{
    enum { INSIDE = 24 };
    shmgen_subscriber subscriber;
    shmgen_link *end = &subscriber.end;
    if (open_subscriber(&subscriber) != SHMGEN_OK)
        return;
    for (int64_t n = setting("n", 2); n > 0; n--) {
        while (!shmgen_enter(end, setting("lock_ms", 0) * MS))
            pause_ms(600);
        trace("-- holds the lock");
        for (int other = 0; other < ACTORS; other++)
            if (other != self && check_values[INSIDE + other] && is_alive(other) && stalls == 0)
                fail("TWO INSIDE: %c and %c", 'A' + other, 'A' + self);
        check_values[INSIDE + self] = 1;
        if (setting("hold", 0))
            pause_ms(setting("hold", 0));
        else
            shmgen_store(end, SHMGEN_AT(missed), shmgen_load(end, SHMGEN_AT(missed)) + 1);
        finish_access();
        check_values[INSIDE + self] = 0;
        shmgen_leave(end);
    }
}

/* Keep a region of depth D (depth=D) open for `ms`, as a writer (writes=1) or as a reader. If the region loses its name, it
 * must be marked as retired. No endpoint may replace the region of a writer, or any region if unreplaced=1. */
static void holder(void)
{
    const bool writes = setting("writes", 0) != 0;
    shmgen_publisher publisher;
    shmgen_subscriber subscriber;
    shmgen_link *link = writes ? &publisher.end : &subscriber.end;
    if ((writes ? open_publisher(&publisher) : open_subscriber(&subscriber)) != SHMGEN_OK)
        return;
    for (int64_t left = setting("ms", 30); left > 0; left -= 10) {
        const bool has_name = shmgen_leads_to(link->name, link->file);
        const bool is_retired = shmgen_is_retired(link);
        finish_access();
        if (!has_name && !is_retired)
            fail("ORPHAN: the region of %c has no name, but is not retired", 'A' + self);
        if ((writes || setting("unreplaced", 0)) && is_retired && stalls == 0)
            fail("ROBBED: the region of %c was replaced during use", 'A' + self);
        pause_ms(10);
    }
    shmgen_link_close(link);
}

const endpoint c_endpoints[] = {
    {"writer", writer}, {"reader", reader}, {"waiter", waiter}, {"locker", locker}, {"holder", holder}, {NULL, NULL}};

/* --- before and after -------------------------------------------------------------------------------------- */

static void c_writes_before(int samples, uint32_t number)
{
    shmgen_publisher publisher;
    try_open_publisher(&publisher);
    if (number != 0)
        publisher.sequence = number - (uint32_t)samples;
    while (samples-- > 0)
        publish(&publisher);
    close_all(self);
}

/* Create the region before the actors start (empty=1: do not). A C process may write samples first, then stop:
 * c_wrote=2 number=5 writes the samples 4 and 5. plc_wrote does the same with a PLC. */
void set_up(void)
{
    const uint32_t number = (uint32_t)setting("number", 0);
    shmgen_subscriber subscriber;
    self = ACTORS - 1;
    set_up_calls();
    if (setting("empty", 0))
        return;
    open_subscriber(&subscriber);
    shmgen_open_event(&subscriber.end);
    if (setting("c_wrote", 0))
        c_writes_before((int)setting("c_wrote", 0), number);
    if (setting("plc_wrote", 0))
        plc_writes_before((int)setting("plc_wrote", 0), number);
    close_all(self);
    self = 0;
}

/* Check that a new reader reads the newest sample (except if may_hide=1), and that the lock has one token. */
void check_end_state(void)
{
    shmgen_subscriber subscriber;
    pair message = {0, 0};
    shmgen_status status;
    bool none_crashed = true;
    int tokens;
    for (int actor = 0; actor < ACTORS; actor++)
        none_crashed = none_crashed && !has_crashed(actor);
    self = ACTORS - 1;
    status = open_subscriber(&subscriber);
    if (status != SHMGEN_OK) {
        fail("CLOSED: a new reader cannot open: %s", shmgen_status_text(status));
        return;
    }
    if (subscriber.end.lock != NULL) {
        tokens = shmgen_tokens(subscriber.end.lock);
        if (tokens > 1 && (stalls == 0 || setting("one_token", 0)))
            fail("SURPLUS: the lock has %d tokens", tokens);
        if (tokens < 1 && none_crashed)
            fail("LOCKED: no actor crashed, but the lock is not free");
    }
    if (response_count() < (uint64_t)setting("answers", 0) && none_crashed && stalls == 0)
        fail("UNANSWERED: only %u responses", (unsigned)response_count());
    if (newest_published() == 0 && setting("sends", 0))
        fail("UNSENT: no sample was published");
    if (newest_published() == 0)
        return;
    status = shmgen_subscriber_read(&subscriber, &message, sizeof message, 0, NULL);
    if (status != SHMGEN_OK && setting("may_hide", 0))
        return;
    if (status != SHMGEN_OK)
        fail("HIDDEN: sample %u was published, but a new reader gets: %s", newest_published(), shmgen_status_text(status));
    else if (is_later(newest_published(), subscriber.sequence) && !setting("may_hide", 0))
        fail("HIDDEN: sample %u was published, but a new reader gets %u", newest_published(), subscriber.sequence);
    else
        check_sample(subscriber.sequence, message.a, message.b);
}
