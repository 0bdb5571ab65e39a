/* Opening: each step from each state, whatever lies in the files, whatever becomes of them meanwhile, and whoever they belong to. */
#include "anything.h"

static shmgen_publisher writer;
static shmgen_subscriber reader;
static char group[300];

/* The longest name that opening gives. */
static void placed(shmgen_link *end, shmgen_step step)
{
    opened(end, shmgen_type_of_shm_diagnostic_msgs_DiagnosticArray(), NULL);
    memset(end->name, 'a', SHMGEN_LONGEST + 1);
    end->name[0] = '/';
    end->name[SHMGEN_LONGEST + 1] = 0;
    end->event = NULL;
    end->file = (int)between(0, INT32_MAX);
    end->since = between(0, SHMGEN_END * 1000 * SHMGEN_MS);
    end->mode = any;
    end->group = some() ? -1 : any;
    end->attempts = (uint32_t)between(0, SHMGEN_ATTEMPTS);
    end->step = step;
    if (step < SHMGEN_STEP_HEADER)
        end->base = end->mine = NULL;
}

static void stepped(shmgen_step step)
{
    memset(&writer, 0, sizeof writer);
    placed(&writer.end, step);
    writer.closed_status = SHMGEN_OPENING;
    writer.new_turn = some() ? 0 : 1;
    writer.turn = any;
    writer.beat = any;
    shmgen_publisher_step(&writer);
    shmgen_publisher_close(&writer);
}

static void watched(shmgen_step step)
{
    memset(&reader, 0, sizeof reader);
    placed(&reader.end, step);
    reader.closed_status = SHMGEN_OPENING;
    reader.end.watches = reader.end.passive = 1;
    shmgen_subscriber_step(&reader);
    shmgen_subscriber_close(&reader);
}

int main(void)
{
    given(group, sizeof group);
    group[sizeof group - 1] = 0;
    shmgen_group(group);
    for (int step = SHMGEN_STEP_FILE; step < SHMGEN_STEP_READY; step++)
        stepped((shmgen_step)step);
    for (int step = SHMGEN_STEP_FILE; step < SHMGEN_STEP_CLAIM; step++)
        watched((shmgen_step)step);
    placed(&reader.end, SHMGEN_STEP_READY);
    shmgen_open_event(&reader.end);
    shmgen_subscriber_close(&reader);
}
