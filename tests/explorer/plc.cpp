// The function blocks as a PLC runs them: Structured Text, translated by tests/softplc and included before this file.
// SysShm and SysSem are those of the soft PLC, on the explorer's files and semaphores.
#include "checks.h"

template <class Block> static void run(Block &block) {
    const char *trap = guarded([&] { block.body(); });
    settle();
    if (trap != nullptr) fail("TRAP: %s", trap);
}

extern "C" {

static void begin(T_fb_ex_msgs_pair_publisher &block) {
    block.v_xenable = BOOL(true);
    block.v_udidepth = static_cast<UDINT>(told("depth", 1));
    strcpy(block.v_stopic.units, TOPIC);
}

static void cycle(T_fb_ex_msgs_pair_publisher &block) {
    const uint64_t content = new_content();
    block.v_msg.v_a = block.v_msg.v_b = content;
    run(block);
    if (block.v_xsent.byte) published(block.v_udisequence, content);
    else say("-- PLC: %s, error %d", block.v_xbusy.byte ? "busy" : "has not sent", static_cast<int>(block.v_eerrorid));
}

static void wait_for_start() {
    if (told("start", 0)) pause_ms(told("start", 0));
}

// n cycles, one each `every` ms; sends=1: at least one of them sends a sample.
static void plc_writer() {
    enum { IN_USE = 40 };
    T_fb_ex_msgs_pair_publisher block{};
    bool has_sent = false;
    wait_for_start();
    begin(block);
    for (int64_t n = told("n", 3); n > 0; n--) {
        const bool was_ready = block.v__fbregion.v_xready.byte;
        cycle(block);
        if (was_ready && static_cast<int>(block.v_eerrorid) == IN_USE && stalls == 0)
            fail("STOLEN: %c lives, and has lost the topic", 'A' + self);
        has_sent = has_sent || block.v_xsent.byte;
        pause_ms(told("every", 100));
    }
    if (told("sends", 0) && !has_sent)
        fail("UNSENT: %c has sent nothing", 'A' + self);
}

// sees=1: at the end it has read the newest sample.
static void plc_reader() {
    T_fb_ex_msgs_pair_subscriber block{};
    wait_for_start();
    block.v_xenable = BOOL(true);
    block.v_udidepth = static_cast<UDINT>(told("depth", 1));
    block.v_xnewest = BOOL(!told("next", 0));
    strcpy(block.v_stopic.units, TOPIC);
    for (int64_t n = told("n", 3); n > 0; n--) {
        run(block);
        if (block.v_xnewdata.byte) received(block.v_udisequence, block.v_msg.v_a, block.v_msg.v_b);
        if (told("every", 0)) pause_ms(told("every", 0));
    }
    if (told("sees", 0) && is_later(newest_published(), block.v_udisequence))
        fail("HIDDEN: %u was published, a PLC has read %u", newest_published(), block.v_udisequence);
}

// One call after the other for n cycles; each times out after `patience` ms.
static void plc_client() {
    T_fb_ex_msgs_ask_client block{};
    start_client();
    block.v_xenable = BOOL(true);
    block.v_ttimeout = TIME{static_cast<uint32_t>(told("patience", 0))};
    strcpy(block.v_sservice.units, SERVICE);
    for (int64_t n = told("n", 5); n > 0; n--) {
        if (!block.v_xbusy.byte && !block.v_xexecute.byte) block.v_request.v_a = block.v_request.v_b = new_question();
        block.v_xexecute = BOOL(block.v_xbusy.byte || !block.v_xexecute.byte);
        run(block);
        if (block.v_xdone.byte) answered(block.v_request.v_a, block.v_response.v_a, block.v_response.v_b);
        pause_ms(told("every", 100));
    }
}

// For n cycles; answers each call in the cycle after it took it.
static void plc_server() {
    T_fb_ex_msgs_ask_server block{};
    wait_for_start();
    block.v_xenable = BOOL(true);
    strcpy(block.v_sservice.units, SERVICE);
    for (int64_t n = told("n", 5); n > 0; n--) {
        const bool executed = block.v_xexecute.byte;
        block.v_xdone = BOOL(executed);
        run(block);
        if (block.v_xexecute.byte && !executed)
            block.v_response.v_a = block.v_response.v_b = taken(block.v_request.v_a, block.v_request.v_b);
        pause_ms(told("every", 100));
    }
}

void plc_was_here(int samples, uint32_t number) {
    T_fb_ex_msgs_pair_publisher block{};
    begin(block);
    block.v_xsend = BOOL(false);
    while (!block.v__fbregion.v_xready.byte) {
        block.body();
        now += 100 * MS;
    }
    if (number != 0) block.v__fbregion.v__udilast = number - static_cast<uint32_t>(samples);
    block.v_xsend = BOOL(true);
    while (samples-- > 0) cycle(block);
}

extern const end plc_ends[] = {{"plc_writer", plc_writer}, {"plc_reader", plc_reader}, {"plc_client", plc_client},
    {"plc_server", plc_server}, {nullptr, nullptr}};

}
