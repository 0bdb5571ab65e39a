/* The shipped C functions of the blocks for OpenPLC and Beremiz: topics, and both sides of a service. */
#include "checks.h"

#include "ex_msgs/msg/pair_shm.h"
#include "ex_msgs/srv/ask_reply_shm.h"
#include "ex_msgs/srv/ask_request_shm.h"
#include "shmgen_block_calls.h"

/* The heap of the blocks (-Dcalloc, -Dfree). It is empty at the start of each schedule. */
static unsigned char heap[64 * 1024] __attribute__((aligned(64)));
static size_t heap_used;

void *explored_calloc(size_t count, size_t size)
{
    unsigned char *block = heap + heap_used;
    heap_used += (count * size + 63) / 64 * 64;
    if (heap_used > sizeof heap)
        fail("the heap is too small");
    return memset(block, 0, count * size);
}

void explored_free(void *unused)
{
    (void)unused;
}

/* End this cycle and wait for the next cycle. */
static void end_cycle(const shmgen_block *block)
{
    shmgen_block_leave(block);
    finish_access();
    pause_ms(setting("every", 100));
}

/* Return the region that the block opens at present. */
static const shmgen_link *opening_link(const shmgen_block *block)
{
    const shmgen_client *client = &block->call->client;
    const shmgen_server *server = &block->call->server;
    if (block->call == NULL)
        return block->writer ? &block->publisher.end : &block->subscriber.end;
    if (block->writer)
        return client->requests.end.step != SHMGEN_STEP_READY ? &client->requests.end : &client->responses.end;
    return server->requests.end.step != SHMGEN_STEP_READY ? &server->requests.end : &server->responses.end;
}

/* Open the files of the region without steps. With opening=1, these calls are steps. */
static void open_without_steps(shmgen_block *block)
{
    const bool was_without_steps = without_steps;
    finish_access();
    without_steps = without_steps || !setting("opening", 0);
    while (without_steps && block->opening && opening_link(block)->step < SHMGEN_STEP_LOCK && !shmgen_block_is_open(block))
        pause_ms(1);
    without_steps = was_without_steps;
}

/* --- a topic ----------------------------------------------------------------------------------------------- */

static shmgen_block *open_topic(uint32_t *number, bool writes)
{
    const shmgen_type type = shmgen_type_of_shm_ex_msgs_Pair();
    shmgen_block *block = shmgen_block_enter(number, number, true);
    if (block == NULL) {
        block = shmgen_block_open(number, number, &type, writes, TOPIC, strlen(TOPIC), (uint32_t)setting("depth", 1));
        open_without_steps(block);
    }
    return block;
}

static void block_writer(void)
{
    uint32_t number = 0;
    if (setting("start", 0))
        pause_ms(setting("start", 0));
    for (int64_t n = setting("n", 3); n > 0; n--) {
        const uint64_t content = new_content();
        shmgen_block *block = open_topic(&number, true);
        *(shm_ex_msgs_Pair *)block->message = (shm_ex_msgs_Pair){content, content};
        if (shmgen_block_write(block, true, SHMGEN_OK))
            note_published(block->sequence, content);
        else
            trace("-- block: %s", shmgen_status_text(block->error));
        end_cycle(block);
    }
}

static void block_reader(void)
{
    uint32_t number = 0;
    for (int64_t n = setting("n", 3); n > 0; n--) {
        shmgen_block *block = open_topic(&number, false);
        const shm_ex_msgs_Pair *message = (const shm_ex_msgs_Pair *)block->message;
        if (shmgen_block_read(block, !setting("next", 0), shmgen_receive_shm_ex_msgs_Pair))
            check_sample(block->sequence, message->a, message->b);
        end_cycle(block);
    }
}

/* --- a service --------------------------------------------------------------------------------------------- */

static shmgen_block *open_service(uint32_t *number, bool calls)
{
    shmgen_interface carries;
    shmgen_block *block = shmgen_block_enter(number, number, true);
    memset(&carries, 0, sizeof carries);
    carries.request = shmgen_part_of(shmgen_type_of_shm_ex_msgs_Ask_Request(), NULL, NULL);
    carries.response = shmgen_part_of(shmgen_type_of_shm_ex_msgs_Ask_Reply(), NULL, NULL);
    if (block == NULL)
        block = shmgen_call_open(number, number, &carries, calls, SERVICE, strlen(SERVICE));
    if (!block->ready)
        open_without_steps(block);
    return block;
}

void start_client(void)
{
    if (setting("start", 0))
        pause_ms(setting("start", 0));
    if (setting("removes", 0))
        shm_unlink(SERVICE "-request");
}

/* Call the service for n cycles, one call after another. Each call ends after `timeout` ms. */
static void block_client(void)
{
    uint32_t number = 0;
    uint64_t request = 0;
    bool executes = true;
    start_client();
    for (int64_t n = setting("n", 5); n > 0; n--) {
        shmgen_block *end = open_service(&number, true);
        shmgen_block_client_cycle(end, executes, false);
        if (shmgen_block_client_sends(end)) {
            request = new_request();
            *(shm_ex_msgs_Ask_Request *)end->message = (shm_ex_msgs_Ask_Request){request, request};
            shmgen_block_client_send(end);
        }
        if (shmgen_block_client_ends(end, setting("timeout", 0) * MS)) {
            const shm_ex_msgs_Ask_Reply *message = (const shm_ex_msgs_Ask_Reply *)end->call->response;
            check_response(request, message->response.a, message->response.b);
        }
        executes = end->call->busy; /* false for one cycle between two calls */
        executes = executes || !(end->call->done || end->call->failed || end->call->aborted);
        end_cycle(end);
    }
}

/* Serve for n cycles. Respond in the cycle after a request was taken. */
static void block_server(void)
{
    uint32_t number = 0;
    uint64_t answer = 0;
    int32_t job = 0;
    if (setting("start", 0))
        pause_ms(setting("start", 0));
    for (int64_t n = setting("n", 5); n > 0; n--) {
        shmgen_block *end = open_service(&number, false);
        shmgen_block_server_cycle(end, job);
        if (shmgen_block_server_responds(end)) {
            ((shm_ex_msgs_Ask_Reply *)end->call->response)->response = (shm_ex_msgs_Ask_Response){answer, answer};
            shmgen_block_server_respond(end, 1, 2);
        }
        if (shmgen_block_server_takes(end, 2)) {
            const shm_ex_msgs_Ask_Request *message = (const shm_ex_msgs_Ask_Request *)end->message;
            answer = take_request(message->a, message->b);
        }
        job = end->call->execute ? 1 : 0;
        end_cycle(end);
    }
}

const endpoint call_endpoints[] = {{"block_writer", block_writer}, {"block_reader", block_reader}, {"block_client", block_client},
    {"block_server", block_server}, {NULL, NULL}};

/* Create the two regions of the service, and empty the table of blocks. */
void set_up_calls(void)
{
    const shmgen_type types[] = {shmgen_type_of_shm_ex_msgs_Ask_Request(), shmgen_type_of_shm_ex_msgs_Ask_Reply()};
    shmgen_subscriber subscriber;
    heap_used = 0;
    memset(shmgen_blocks, 0, sizeof shmgen_blocks);
    memset(shmgen_owners, 0, sizeof shmgen_owners);
    memset(shmgen_busy, 0, sizeof shmgen_busy);
    if (!setting("service", 0))
        return;
    shmgen_subscriber_open(&subscriber, SERVICE "-request", &types[0], NULL);
    shmgen_subscriber_open(&subscriber, SERVICE "-response", &types[1], NULL);
}
