/* Opening: each step from each state, with any content, any owner and any concurrent change of the files. */
#include "environment.h"

static shmgen_publisher publisher;
static shmgen_subscriber subscriber;
static char group[300];

/* Set the state before a step of opening. The region has the longest possible name. */
static void set_opening_state(shmgen_link *link, shmgen_step step)
{
    set_open_state(link, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), NULL);
    memset(link->name, 'a', SHMGEN_LONGEST + 1);
    link->name[0] = '/';
    link->name[SHMGEN_LONGEST + 1] = 0;
    link->event = NULL;
    link->file = (int)any_between(0, INT32_MAX);
    link->since = any_between(0, CLOCK_LIMIT_S * 1000 * SHMGEN_MS);
    link->mode = any;
    link->group = any_bool() ? -1 : any;
    link->attempts = (uint32_t)any_between(0, SHMGEN_ATTEMPTS);
    link->step = step;
    if (step < SHMGEN_STEP_HEADER)
        link->base = link->mine = NULL;
}

static void step_publisher(shmgen_step step)
{
    memset(&publisher, 0, sizeof publisher);
    set_opening_state(&publisher.end, step);
    publisher.closed_status = SHMGEN_OPENING;
    publisher.new_turn = any_bool() ? 0 : 1;
    publisher.turn = any;
    publisher.beat = any;
    shmgen_publisher_step(&publisher);
    shmgen_publisher_close(&publisher);
}

static void step_subscriber(shmgen_step step)
{
    memset(&subscriber, 0, sizeof subscriber);
    set_opening_state(&subscriber.end, step);
    subscriber.closed_status = SHMGEN_OPENING;
    subscriber.end.watches = subscriber.end.passive = 1;
    shmgen_subscriber_step(&subscriber);
    shmgen_subscriber_close(&subscriber);
}

int main(void)
{
    make_unknown(group, sizeof group);
    group[sizeof group - 1] = 0;
    shmgen_group(group);
    for (int step = SHMGEN_STEP_FILE; step < SHMGEN_STEP_READY; step++)
        step_publisher((shmgen_step)step);
    for (int step = SHMGEN_STEP_FILE; step < SHMGEN_STEP_CLAIM; step++)
        step_subscriber((shmgen_step)step);
    set_opening_state(&subscriber.end, SHMGEN_STEP_READY);
    shmgen_open_event(&subscriber.end);
    shmgen_subscriber_close(&subscriber);
}
