/* The blocks of the open PLCs, as the headers are shipped: topics, and both sides of a service. */
#include "checks.h"

#include "ex_msgs/msg/pair_shm.h"
#include "ex_msgs/srv/ask_reply_shm.h"
#include "ex_msgs/srv/ask_request_shm.h"
#include "shmgen_block_calls.h"

/* What the blocks take from the heap (-Dcalloc, -Dfree), as it was at the start of the schedule. */
static unsigned char heap[64 * 1024] __attribute__((aligned(64)));
static size_t heap_used;

void *explored_calloc(size_t count, size_t size)
{
    unsigned char *made = heap + heap_used;
    heap_used += (count * size + 63) / 64 * 64;
    if (heap_used > sizeof heap)
        fail("the heap is too small");
    return memset(made, 0, count * size);
}

void explored_free(void *unused)
{
    (void)unused;
}

/* Waits for the next cycle. */
static void end_cycle(const shmgen_block *block)
{
    shmgen_block_leave(block);
    settle();
    pause_ms(told("every", 100));
}

/* The end that the block is opening. */
static const shmgen_link *opening_of(const shmgen_block *block)
{
    const shmgen_client *client = &block->call->client;
    const shmgen_server *server = &block->call->server;
    if (block->call == NULL)
        return block->writer ? &block->publisher.end : &block->subscriber.end;
    if (block->writer)
        return client->requests.end.step != SHMGEN_STEP_READY ? &client->requests.end : &client->responses.end;
    return server->requests.end.step != SHMGEN_STEP_READY ? &server->requests.end : &server->responses.end;
}

/* How a region comes to be is explored where opening=1 says so. */
static void open_quietly(shmgen_block *block)
{
    const bool was_quiet = quiet;
    settle();
    quiet = quiet || !told("opening", 0);
    while (quiet && block->opening && opening_of(block)->step < SHMGEN_STEP_LOCK && !shmgen_block_is_open(block))
        pause_ms(1);
    quiet = was_quiet;
}

/* --- a topic ----------------------------------------------------------------------------------------------- */

static shmgen_block *enter_topic(uint32_t *number, bool writes)
{
    const shmgen_type type = shmgen_type_of_shm_ex_msgs_Pair();
    shmgen_block *block = shmgen_block_enter(number, number, true);
    if (block == NULL) {
        block = shmgen_block_open(number, number, &type, writes, TOPIC, strlen(TOPIC), (uint32_t)told("depth", 1));
        open_quietly(block);
    }
    return block;
}

static void block_writer(void)
{
    uint32_t number = 0;
    if (told("start", 0))
        pause_ms(told("start", 0));
    for (int64_t n = told("n", 3); n > 0; n--) {
        const uint64_t content = new_content();
        shmgen_block *block = enter_topic(&number, true);
        *(shm_ex_msgs_Pair *)block->message = (shm_ex_msgs_Pair){content, content};
        if (shmgen_block_write(block, true, SHMGEN_OK))
            published(block->sequence, content);
        else
            say("-- block: %s", shmgen_status_text(block->error));
        end_cycle(block);
    }
}

static void block_reader(void)
{
    uint32_t number = 0;
    for (int64_t n = told("n", 3); n > 0; n--) {
        shmgen_block *block = enter_topic(&number, false);
        const shm_ex_msgs_Pair *message = (const shm_ex_msgs_Pair *)block->message;
        if (shmgen_block_read(block, !told("next", 0), shmgen_receive_shm_ex_msgs_Pair))
            received(block->sequence, message->a, message->b);
        end_cycle(block);
    }
}

/* --- a service --------------------------------------------------------------------------------------------- */

static shmgen_block *enter_service(uint32_t *number, bool calls)
{
    shmgen_interface carries;
    shmgen_block *block = shmgen_block_enter(number, number, true);
    memset(&carries, 0, sizeof carries);
    carries.request = shmgen_part_of(shmgen_type_of_shm_ex_msgs_Ask_Request(), NULL, NULL);
    carries.response = shmgen_part_of(shmgen_type_of_shm_ex_msgs_Ask_Reply(), NULL, NULL);
    if (block == NULL)
        block = shmgen_call_open(number, number, &carries, calls, SERVICE, strlen(SERVICE));
    if (!block->ready)
        open_quietly(block);
    return block;
}

void start_client(void)
{
    if (told("start", 0))
        pause_ms(told("start", 0));
    if (told("removes", 0))
        shm_unlink(SERVICE "-request");
}

/* One call after the other for n cycles; each times out after `patience` ms. */
static void block_client(void)
{
    uint32_t number = 0;
    uint64_t question = 0;
    bool executes = true;
    start_client();
    for (int64_t n = told("n", 5); n > 0; n--) {
        shmgen_block *end = enter_service(&number, true);
        shmgen_block_client_cycle(end, executes, false);
        if (shmgen_block_client_sends(end)) {
            question = new_question();
            *(shm_ex_msgs_Ask_Request *)end->message = (shm_ex_msgs_Ask_Request){question, question};
            shmgen_block_client_send(end);
        }
        if (shmgen_block_client_ends(end, told("patience", 0) * MS)) {
            const shm_ex_msgs_Ask_Reply *message = (const shm_ex_msgs_Ask_Reply *)end->call->response;
            answered(question, message->response.a, message->response.b);
        }
        executes = end->call->busy; /* it falls for a cycle between two calls */
        executes = executes || !(end->call->done || end->call->failed || end->call->aborted);
        end_cycle(end);
    }
}

/* For n cycles; answers each call in the cycle after it took it. */
static void block_server(void)
{
    uint32_t number = 0;
    uint64_t answer = 0;
    int32_t job = 0;
    if (told("start", 0))
        pause_ms(told("start", 0));
    for (int64_t n = told("n", 5); n > 0; n--) {
        shmgen_block *end = enter_service(&number, false);
        shmgen_block_server_cycle(end, job);
        if (shmgen_block_server_responds(end)) {
            ((shm_ex_msgs_Ask_Reply *)end->call->response)->response = (shm_ex_msgs_Ask_Response){answer, answer};
            shmgen_block_server_respond(end, 1, 2);
        }
        if (shmgen_block_server_takes(end, 2)) {
            const shm_ex_msgs_Ask_Request *message = (const shm_ex_msgs_Ask_Request *)end->message;
            answer = taken(message->a, message->b);
        }
        job = end->call->execute ? 1 : 0;
        end_cycle(end);
    }
}

const end call_ends[] = {{"block_writer", block_writer}, {"block_reader", block_reader}, {"block_client", block_client},
    {"block_server", block_server}, {NULL, NULL}};

/* The two regions of the service, and a table of blocks with nothing in it. */
void set_up_calls(void)
{
    const shmgen_type types[] = {shmgen_type_of_shm_ex_msgs_Ask_Request(), shmgen_type_of_shm_ex_msgs_Ask_Reply()};
    shmgen_subscriber subscriber;
    heap_used = 0;
    memset(shmgen_blocks, 0, sizeof shmgen_blocks);
    memset(shmgen_owners, 0, sizeof shmgen_owners);
    memset(shmgen_busy, 0, sizeof shmgen_busy);
    if (!told("service", 0))
        return;
    shmgen_subscriber_open(&subscriber, SERVICE "-request", &types[0], NULL);
    shmgen_subscriber_open(&subscriber, SERVICE "-response", &types[1], NULL);
}
