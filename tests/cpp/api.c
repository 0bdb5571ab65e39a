/* Tests of the C API in one process, which opens both the publisher and the subscriber.
 *
 *   api CASE TOPIC      prints the failed check, or nothing
 */
#include "shm_plc_demo/shmgen.h"

#include <string.h>

static void (*during_copy)(void); /* runs in the middle of a copy, like another process */

static void copy_in_two_halves(void *buffer, const void *from, size_t size)
{
    memcpy(buffer, from, size / 2);
    if (during_copy != NULL)
        during_copy();
    memcpy((char *)buffer + size / 2, (const char *)from + size / 2, size - size / 2);
}

#define SHMGEN_COPY copy_in_two_halves
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

#include "shm_plc_demo/shmgen_client.h"
#include "shm_plc_demo/shmgen_notifier.h"
#include "shm_plc_demo/shmgen_server.h"

#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>

#define CHECK(condition) ((condition) ? (void)0 : (printf("%d: %s\n", __LINE__, #condition), exit(1)))

enum { LARGE = 4096 };
static const char *topic;
static const shmgen_type large = {"demo_msgs/msg/Large", NULL, 1, LARGE, 0, 0, 0};
static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shmgen_subscriber other;
static shm_demo_msgs_Demo message;
static const uint32_t zero = 0;

static void open_both(uint32_t depth)
{
    const shmgen_options options = {.depth = depth};
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_OK);
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_OK);
}

static void publish(uint32_t a)
{
    message.a = a;
    CHECK(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_OK);
}

static shmgen_status open_second_publisher(void)
{
    static shm_demo_msgs_Demo_publisher second;
    return shm_demo_msgs_Demo_publisher_open(&second, topic, NULL);
}

static pid_t run_in_child(void (*function)(void))
{
    const pid_t child = fork();
    if (child != 0)
        return child;
    function();
    _exit(0);
}

/* --- begin and complete ---------------------------------------------------------------------------------------- */

static void calls_in_a_wrong_order_are_refused(void)
{
    void *payload, *second;
    open_both(1);
    CHECK(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    CHECK(shmgen_publisher_begin(&publisher.end, 0, &payload) == SHMGEN_OK);
    CHECK(shmgen_publisher_begin(&publisher.end, 0, &second) == SHMGEN_MISUSED);
    CHECK(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_MISUSED);
    memcpy(payload, &message, sizeof message);
    CHECK(shmgen_publisher_complete(&publisher.end) == SHMGEN_OK);
    CHECK(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    CHECK(shmgen_publisher_enter(&publisher.end, 0) == SHMGEN_OK);
    CHECK(shmgen_publisher_begin(&publisher.end, 0, &payload) == SHMGEN_OK); /* the publisher already holds the lock */
    shmgen_publisher_cancel(&publisher.end);
    CHECK(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    CHECK(publisher.end.sequence == 1 && shmgen_load(&publisher.end.end, SHMGEN_AT(completed0)) == 1);
    CHECK(shmgen_tokens(publisher.end.end.lock) == 1);
}

/* --- waiting --------------------------------------------------------------------------------------------------- */

static void clear_newest_sample(void)
{
    const size_t slot = shmgen_find(&other.end, shmgen_newest(&other.end));
    if (slot != 0)
        shmgen_store(&other.end, slot + offsetof(shmgen_slot, number), 0);
}

static void a_failed_wait_reports_if_the_message_changed(void)
{
    static unsigned char before[LARGE], buffer[LARGE];
    static shmgen_publisher writer;
    shm_demo_msgs_Demo small = {.a = 7};
    memset(before, 0xAA, LARGE);
    memset(buffer, 0xAA, LARGE);
    CHECK(shmgen_publisher_open(&writer, topic, &large, NULL) == SHMGEN_OK);
    CHECK(shmgen_subscriber_open(&other, topic, &large, NULL) == SHMGEN_OK);
    CHECK(shmgen_subscriber_wait(&other, buffer, LARGE, SHMGEN_MS, NULL) == SHMGEN_NOTHING_NEW);
    CHECK(memcmp(buffer, before, LARGE) == 0);
    CHECK(shmgen_publisher_write(&writer, before, LARGE, 0) == SHMGEN_OK);
    during_copy = clear_newest_sample;
    CHECK(shmgen_subscriber_wait(&other, buffer, LARGE, 5 * SHMGEN_MS, NULL) == SHMGEN_OVERWRITTEN);
    shmgen_publisher_close(&writer);
    CHECK(shm_unlink(other.end.name) == 0);
    shmgen_subscriber_close(&other);
    during_copy = NULL;
    open_both(1);
    publish(1);
    other = subscriber.end;
    during_copy = clear_newest_sample;
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &small, 5 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    CHECK(small.a == 7);
}

static void publish_late(void)
{
    shmgen_pause(20 * SHMGEN_MS);
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    publish(5);
    publish(6);
}

static void a_wait_can_be_unlimited(void)
{
    pid_t child;
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    child = run_in_child(publish_late);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_OK);
    CHECK(message.a == 5 || message.a == 6);
    CHECK(waitpid(child, NULL, 0) == child);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MIN) != SHMGEN_CLOSED); /* sample 6, or no sample */
}

static void stop_waiting(int signal)
{
    (void)signal;
    shmgen_subscriber_stop(&subscriber.end);
}

static void signal_the_parent(void)
{
    shmgen_pause(20 * SHMGEN_MS);
    kill(getppid(), SIGUSR1);
}

static void a_signal_handler_ends_a_wait(void)
{
    struct sigaction action;
    pid_t child;
    shmgen_subscriber *both[2] = {&other, &subscriber.end};
    memset(&action, 0, sizeof action);
    action.sa_handler = stop_waiting;
    CHECK(sigaction(SIGUSR1, &action, NULL) == 0);
    open_both(1);
    CHECK(shmgen_subscriber_open(&other, topic, &subscriber.end.end.type, NULL) == SHMGEN_OK);
    child = run_in_child(signal_the_parent);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_STOPPED);
    CHECK(waitpid(child, NULL, 0) == child);
    CHECK(shmgen_ready_any(both, 2, INT64_MAX) == SHMGEN_STOPPED);
    publish(1);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_STOPPED);
    CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK); /* read never waits */
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_OK);
}

static bool is_readable(const shmgen_notifier *notifier, int ms)
{
    struct pollfd file = {.fd = shmgen_notifier_fd(notifier), .events = POLLIN};
    return poll(&file, 1, ms) == 1;
}

static void a_notifier_reports_each_sample(void)
{
    static shmgen_notifier notifier;
    open_both(1);
    publish(1);
    CHECK(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    CHECK(shmgen_notifier_add(&notifier, &other) == SHMGEN_CLOSED);
    CHECK(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK);
    CHECK(is_readable(&notifier, 5000)); /* reports the existing sample */
    CHECK(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
    CHECK(!is_readable(&notifier, 20)); /* reports a sample once, even if it stays unread */
    for (uint32_t a = 2; a < 100; a++) {
        publish(a);
        CHECK(is_readable(&notifier, 5000));
        CHECK(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
        CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK && message.a == a);
    }
    shmgen_notifier_remove(&notifier, &subscriber.end);
    publish(100);
    CHECK(!is_readable(&notifier, 30) && shmgen_notifier_next(&notifier) == NULL);
    CHECK(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK && is_readable(&notifier, 5000));
    shmgen_notifier_close(&notifier);
    shmgen_notifier_close(&notifier);
    CHECK(shmgen_notifier_fd(&notifier) == -1);
    CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK && message.a == 100);
}

static void a_notifier_outlives_a_removed_region(void)
{
    static shmgen_notifier notifier;
    open_both(1);
    CHECK(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    CHECK(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK);
    CHECK(shm_unlink(subscriber.end.end.name) == 0 && is_readable(&notifier, 5000));
    CHECK(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    shm_demo_msgs_Demo_publisher_close(&publisher);
    CHECK(is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) == &subscriber.end); /* repeatedly reports the closed subscriber */
    open_both(1);
    while (shmgen_notifier_next(&notifier) == NULL)
        CHECK(is_readable(&notifier, 5000));
    CHECK(shmgen_notifier_next(&notifier) == NULL);
    publish(1);
    CHECK(is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) == &subscriber.end);
    shm_demo_msgs_Demo_subscriber_close(&subscriber); /* the notifier has mapped the region itself */
    publish(2);
    CHECK(is_readable(&notifier, 5000));
    shmgen_notifier_close(&notifier);
}

static void a_notifier_watches_more_than_one_futex_wait_takes(void)
{
    static shmgen_notifier notifier;
    static shmgen_subscriber many[SHMGEN_MOST_WAITS + 20];
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    CHECK(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    for (size_t index = 0; index < sizeof many / sizeof *many; index++) {
        CHECK(shmgen_subscriber_open(&many[index], topic, &subscriber.end.end.type, NULL) == SHMGEN_OK);
        CHECK(shmgen_notifier_add(&notifier, &many[index]) == SHMGEN_OK);
    }
    publish(1);
    for (size_t done = 0; done < sizeof many / sizeof *many;)
        if (is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) != NULL)
            done++;
    CHECK(shmgen_notifier_next(&notifier) == NULL);
    shmgen_notifier_close(&notifier);
}

static void *stop_client(void *client)
{
    shmgen_pause(20 * SHMGEN_MS);
    shmgen_client_stop((shmgen_client *)client);
    return NULL;
}

static void *stop_server(void *server)
{
    shmgen_pause(20 * SHMGEN_MS);
    shmgen_server_stop((shmgen_server *)server);
    return NULL;
}

static void another_thread_ends_a_call(void)
{
    static shmgen_client client;
    static shmgen_server server;
    char bytes[LARGE];
    pthread_t thread;
    shmgen_interface interface;
    memset(&interface, 0, sizeof interface);
    interface.request = interface.response = shmgen_part_of(large, NULL, NULL);
    memset(bytes, 0, sizeof bytes);
    CHECK(shmgen_client_open(&client, topic, &interface, NULL) == SHMGEN_OK);
    CHECK(pthread_create(&thread, NULL, stop_client, &client) == 0);
    CHECK(shmgen_client_call(&client, bytes, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED);
    CHECK(pthread_join(thread, NULL) == 0);
    shmgen_client_close(&client);
    CHECK(shmgen_client_open(&client, topic, &interface, NULL) == SHMGEN_OK);
    CHECK(shmgen_server_open(&server, topic, &interface, NULL) == SHMGEN_OK);
    CHECK(pthread_create(&thread, NULL, stop_client, &client) == 0);
    CHECK(shmgen_client_call(&client, bytes, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED); /* the server does not respond */
    CHECK(pthread_join(thread, NULL) == 0);
    CHECK(shmgen_server_wait(&server, bytes, LARGE, 0) == SHMGEN_OK);
    CHECK(pthread_create(&thread, NULL, stop_server, &server) == 0);
    CHECK(shmgen_server_wait(&server, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED);
    CHECK(pthread_join(thread, NULL) == 0);
    shmgen_server_close(&server);
    shmgen_client_close(&client);
}

static void one_thread_waits_for_two_topics(void)
{
    static shmgen_publisher writer;
    char second[300];
    shmgen_subscriber *several[2] = {&subscriber.end, &other};
    open_both(1);
    snprintf(second, sizeof second, "%s_second", topic);
    CHECK(shmgen_subscriber_open(&other, second, &large, NULL) == SHMGEN_OK);
    CHECK(shmgen_publisher_open(&writer, second, &large, NULL) == SHMGEN_OK);
    CHECK(shmgen_ready_any(NULL, 0, 2 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    CHECK(shmgen_ready_any(several, 2, 2 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    CHECK(shmgen_load(&other.end, SHMGEN_AT(armed)) == 1 && shmgen_load(&subscriber.end.end, SHMGEN_AT(armed)) == 1);
    publish(1);
    CHECK(shmgen_ready_any(several, 2, INT64_MAX) == SHMGEN_OK);
    CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK);
    CHECK(shmgen_ready_any(several, 2, 0) == SHMGEN_NOTHING_NEW);
    shmgen_subscriber_close(&other);
    CHECK(shmgen_ready_any(several, 2, 0) == SHMGEN_CLOSED);
}

static void publish_clears_armed(void)
{
    open_both(1);
    shmgen_store(&publisher.end.end, SHMGEN_AT(armed), 1); /* as if a waiting reader died */
    publish(1);
    CHECK(shmgen_load(&publisher.end.end, SHMGEN_AT(armed)) == 0);
}

/* --- reading --------------------------------------------------------------------------------------------------- */

static void clear_first_sample(void)
{
    shmgen_store(&other.end, shmgen_slot_of(&other.end, 1, 0) + offsetof(shmgen_slot, number), zero);
}

static void a_sample_cleared_during_the_copy_is_not_read(void)
{
    open_both(3);
    publish(1);
    other = subscriber.end;
    during_copy = clear_first_sample;
    CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OVERWRITTEN);
    CHECK(subscriber.end.sequence == 0);
}

static void borrow_in_child(void)
{
    const void *payload;
    if (shmgen_subscriber_return(&subscriber.end) != SHMGEN_IN_FORKED_CHILD ||
        shmgen_subscriber_borrow(&subscriber.end, &payload) != SHMGEN_IN_FORKED_CHILD)
        _exit(1);
}

static void a_sample_is_read_in_place(void)
{
    const void *payload;
    uint32_t a;
    int wait_status;
    open_both(3);
    CHECK(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_NOTHING_NEW);
    CHECK(shmgen_subscriber_return(&subscriber.end) == SHMGEN_MISUSED);
    publish(1);
    publish(2);
    CHECK(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK);
    CHECK(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_MISUSED);
    memcpy(&a, payload, sizeof a);
    publish(3); /* uses another slot */
    CHECK(waitpid(run_in_child(borrow_in_child), &wait_status, 0) > 0 && wait_status == 0);
    CHECK(shmgen_subscriber_return(&subscriber.end) == SHMGEN_OK && a == 2);
    CHECK(subscriber.end.sequence == 2 && subscriber.end.missed == 1 && shmgen_subscriber_age(&subscriber.end) >= 0);
    CHECK(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK);
    for (a = 4; a <= 7; a++) /* the last sample overwrites the borrowed slot */
        publish(a);
    CHECK(shmgen_subscriber_return(&subscriber.end) == SHMGEN_OVERWRITTEN);
    CHECK(subscriber.end.sequence == 2 && shmgen_tokens(subscriber.end.end.lock) == 1);
    CHECK(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK && memcmp(payload, &message, sizeof a) == 0);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    CHECK(shmgen_subscriber_return(&subscriber.end) == SHMGEN_CLOSED);
}

static void a_passive_subscriber_changes_nothing(void)
{
    const shmgen_options options = {.passive = 1};
    static unsigned char before[8192];
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_REGION_MISSING);
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_OK);
    for (uint32_t a = 1; a <= 3; a++)
        publish(a);
    CHECK(subscriber.end.end.size <= sizeof before);
    memcpy(before, publisher.end.end.base, subscriber.end.end.size);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, SHMGEN_MS) == SHMGEN_OK && message.a == 3);
    CHECK(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    CHECK(subscriber.end.missed == 2);
    CHECK(memcmp(before, publisher.end.end.base, subscriber.end.end.size) == 0);
    CHECK(subscriber.end.end.lock == NULL && subscriber.end.end.event == NULL);
}

static void refused_messages_and_lock_misses_are_counted(void)
{
    open_both(1);
    message.tail_count = 9;
    CHECK(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_COUNT_EXCEEDED);
    CHECK(strcmp(shmgen_publisher_rejected(&publisher.end), "tail") == 0 && shmgen_publisher_refused(&publisher.end) == 1);
    CHECK(shmgen_publisher_write(&publisher.end, &message, sizeof message, 0) == SHMGEN_OK); /* write() does not check the fields */
    CHECK(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_COUNT_EXCEEDED);
    CHECK(strcmp(shmgen_subscriber_rejected(&subscriber.end), "tail") == 0 && shmgen_subscriber_refused(&subscriber.end) == 1);
    CHECK(sem_trywait(publisher.end.end.lock) == 0);
    message.tail_count = 0;
    CHECK(shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message) == SHMGEN_OK || !SHMGEN_KEEPS_ORDER);
    CHECK(shmgen_publisher_lock_misses(&publisher.end) == 1 && shmgen_subscriber_lock_misses(&subscriber.end) == 0);
}

/* --- opening --------------------------------------------------------------------------------------------------- */

static void a_mode_in_decimal_is_refused(void)
{
    shmgen_options options = {.mode = 660};
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_MODE_INVALID);
    options.mode = 0640;
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_OK);
}

static void a_creator_checks_its_header_again(void)
{
    const uint64_t digest = 1;
    shmgen_status status = shm_demo_msgs_Demo_subscriber_start(&subscriber, topic, NULL);
    for (int left = 1000; status == SHMGEN_OPENING && subscriber.end.end.step != SHMGEN_STEP_SETTLE && left > 0; left--)
        status = shmgen_subscriber_step(&subscriber.end);
    CHECK(subscriber.end.end.step == SHMGEN_STEP_SETTLE);
    memcpy(subscriber.end.end.base + SHMGEN_AT(digest), &digest, sizeof digest); /* as if a PLC wrote a header of another layout */
    while (status == SHMGEN_OPENING)
        status = shmgen_subscriber_step(&subscriber.end);
    CHECK(status == SHMGEN_OK && subscriber.end.end.attempts == 1); /* the subscriber replaced the region, which is now retired */
}

static void a_takeover_is_confirmed(void)
{
    shmgen_link *end = &publisher.end.end;
    shmgen_status status;
    CHECK(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(writer), SHMGEN_PLC); /* a stopped PLC */
    status = shm_demo_msgs_Demo_publisher_start(&publisher, topic, NULL);
    while (status == SHMGEN_OPENING && end->step != SHMGEN_STEP_CONFIRM) {
        status = shmgen_publisher_step(&publisher.end);
        end->since -= end->step == SHMGEN_STEP_WATCH ? 2 * SHMGEN_CLAIM_MS * SHMGEN_MS : 0;
    }
    CHECK(end->step == SHMGEN_STEP_CONFIRM && shmgen_load(end, SHMGEN_AT(writer)) == end->pid);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(writer), SHMGEN_PLC); /* as if another PLC claimed the topic meanwhile */
    while (status == SHMGEN_OPENING)
        status = shmgen_publisher_step(&publisher.end);
    CHECK(status == SHMGEN_WRITER_IN_USE);
}

static void a_takeover_keeps_the_newest_sample(void)
{
    shmgen_link *end = &publisher.end.end;
    open_both(1);
    publish(1);
    publish(2);
    publish(3);
    shmgen_store(end, shmgen_completed(1), 4); /* the newest sample, in the other lane */
    shmgen_begin_turn(&publisher.end);
    CHECK(shmgen_finish_claim(&publisher.end) == SHMGEN_OK);
    CHECK(publisher.end.turn == 2 && publisher.end.sequence == 6 && shmgen_load(end, SHMGEN_AT(left)) == 6);
    publish(4);
    CHECK(publisher.end.sequence == 7 && shmgen_newest(end) == 7);
}

/* --- forks ----------------------------------------------------------------------------------------------------- */

static void pause_forever(void)
{
    for (;;)
        pause();
}

static void close_inherited_publisher(void)
{
    shm_demo_msgs_Demo_publisher_close(&publisher);
}

static void a_forked_child_holds_no_claim(void)
{
    pid_t child;
    shmgen_status status;
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    child = run_in_child(pause_forever);
    shm_demo_msgs_Demo_publisher_close(&publisher);
    status = open_second_publisher();
    kill(child, SIGKILL);
    CHECK(waitpid(child, NULL, 0) == child && status == SHMGEN_OK);
}

static void a_forked_child_releases_no_claim(void)
{
    pid_t child;
    CHECK(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    child = run_in_child(close_inherited_publisher);
    CHECK(waitpid(child, NULL, 0) == child && open_second_publisher() == SHMGEN_WRITER_IN_USE);
    publish(1);
}

#define CASE(name) {#name, name}
static const struct {
    const char *name;
    void (*run)(void);
} cases[] = {
    CASE(calls_in_a_wrong_order_are_refused), CASE(a_failed_wait_reports_if_the_message_changed), CASE(a_wait_can_be_unlimited),
    CASE(a_notifier_reports_each_sample), CASE(a_notifier_outlives_a_removed_region),
    CASE(a_notifier_watches_more_than_one_futex_wait_takes), CASE(a_signal_handler_ends_a_wait),
    CASE(another_thread_ends_a_call), CASE(one_thread_waits_for_two_topics), CASE(publish_clears_armed),
    CASE(a_sample_cleared_during_the_copy_is_not_read),
    CASE(a_sample_is_read_in_place), CASE(a_passive_subscriber_changes_nothing), CASE(refused_messages_and_lock_misses_are_counted),
    CASE(a_mode_in_decimal_is_refused), CASE(a_creator_checks_its_header_again), CASE(a_takeover_is_confirmed),
    CASE(a_takeover_keeps_the_newest_sample), CASE(a_forked_child_holds_no_claim), CASE(a_forked_child_releases_no_claim),
};

int main(int count, char **words)
{
    alarm(20);
    topic = count == 3 ? words[2] : "";
    for (size_t index = 0; index < sizeof cases / sizeof *cases; index++)
        if (count == 1)
            puts(cases[index].name);
        else if (strcmp(words[1], cases[index].name) == 0)
            cases[index].run();
    return 0;
}
