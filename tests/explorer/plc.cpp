// The function blocks of a PLC. tests/softplc translates their Structured Text to C++, included before this file. The soft
// PLC's SysShm and SysSem use the files and semaphores of the explorer.
#include "checks.h"

template <class Block> static void run(Block &block) {
    const char *trap = guarded([&] { block.body(); });
    finish_access();
    if (trap != nullptr) fail("TRAP: %s", trap);
}

extern "C" {

static void begin(T_fb_ex_msgs_pair_publisher &block) {
    block.v_xenable = BOOL(true);
    block.v_udidepth = static_cast<UDINT>(setting("depth", 1));
    strcpy(block.v_stopic.units, TOPIC);
}

static void cycle(T_fb_ex_msgs_pair_publisher &block) {
    const uint64_t content = new_content();
    block.v_msg.v_a = block.v_msg.v_b = content;
    run(block);
    if (block.v_xsent.byte) note_published(block.v_udisequence, content);
    else trace("-- PLC: %s, error %d", block.v_xbusy.byte ? "busy" : "has not sent", static_cast<int>(block.v_eerrorid));
}

static void wait_for_start() {
    if (setting("start", 0)) pause_ms(setting("start", 0));
}

// Write in n cycles of `every` ms. sends=1: at least one cycle must send a sample.
static void plc_writer() {
    enum { IN_USE = 40 };
    T_fb_ex_msgs_pair_publisher block{};
    bool has_sent = false;
    wait_for_start();
    begin(block);
    for (int64_t n = setting("n", 3); n > 0; n--) {
        const bool was_ready = block.v__fbregion.v_xready.byte;
        cycle(block);
        if (was_ready && static_cast<int>(block.v_eerrorid) == IN_USE && stalls == 0)
            fail("STOLEN: %c lost the topic without a stall", 'A' + self);
        has_sent = has_sent || block.v_xsent.byte;
        pause_ms(setting("every", 100));
    }
    if (setting("sends", 0) && !has_sent)
        fail("UNSENT: %c has sent no sample", 'A' + self);
}

// Read in n cycles. reads_newest=1: after the last cycle, the newest sample must have been read.
static void plc_reader() {
    T_fb_ex_msgs_pair_subscriber block{};
    wait_for_start();
    block.v_xenable = BOOL(true);
    block.v_udidepth = static_cast<UDINT>(setting("depth", 1));
    block.v_xnewest = BOOL(!setting("next", 0));
    strcpy(block.v_stopic.units, TOPIC);
    for (int64_t n = setting("n", 3); n > 0; n--) {
        run(block);
        if (block.v_xnewdata.byte) check_sample(block.v_udisequence, block.v_msg.v_a, block.v_msg.v_b);
        if (setting("every", 0)) pause_ms(setting("every", 0));
    }
    if (setting("reads_newest", 0) && is_later(newest_published(), block.v_udisequence))
        fail("HIDDEN: sample %u was published, but a PLC has read only %u", newest_published(), block.v_udisequence);
}

// Call the service for n cycles, one call after another. Each call ends after `timeout` ms.
static void plc_client() {
    T_fb_ex_msgs_ask_client block{};
    start_client();
    block.v_xenable = BOOL(true);
    block.v_ttimeout = TIME{static_cast<uint32_t>(setting("timeout", 0))};
    strcpy(block.v_sservice.units, SERVICE);
    for (int64_t n = setting("n", 5); n > 0; n--) {
        if (!block.v_xbusy.byte && !block.v_xexecute.byte) block.v_request.v_a = block.v_request.v_b = new_request();
        block.v_xexecute = BOOL(block.v_xbusy.byte || !block.v_xexecute.byte);
        run(block);
        if (block.v_xdone.byte) check_response(block.v_request.v_a, block.v_response.v_a, block.v_response.v_b);
        pause_ms(setting("every", 100));
    }
}

// Serve for n cycles. Respond in the cycle after a request was taken.
static void plc_server() {
    T_fb_ex_msgs_ask_server block{};
    wait_for_start();
    block.v_xenable = BOOL(true);
    strcpy(block.v_sservice.units, SERVICE);
    for (int64_t n = setting("n", 5); n > 0; n--) {
        const bool executed = block.v_xexecute.byte;
        block.v_xdone = BOOL(executed);
        run(block);
        if (block.v_xexecute.byte && !executed)
            block.v_response.v_a = block.v_response.v_b = take_request(block.v_request.v_a, block.v_request.v_b);
        pause_ms(setting("every", 100));
    }
}

void plc_writes_before(int samples, uint32_t number) {
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

extern const endpoint plc_endpoints[] = {{"plc_writer", plc_writer}, {"plc_reader", plc_reader}, {"plc_client", plc_client},
    {"plc_server", plc_server}, {nullptr, nullptr}};

}
