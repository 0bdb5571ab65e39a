/* What one process can show of both ends in C, in an order that it chooses itself.
 *
 *   alone CASE TOPIC      prints the line that does not hold, or nothing
 */
#include "shm_plc_demo/shmgen.h"

#include <string.h>

static void (*meanwhile)(void); /* done by somebody else while a payload is copied */

static void copy_slowly(void *into, const void *from, size_t size)
{
    memcpy(into, from, size / 2);
    if (meanwhile != NULL)
        meanwhile();
    memcpy((char *)into + size / 2, (const char *)from + size / 2, size - size / 2);
}

#define SHMGEN_COPY copy_slowly
#include "shm_plc_demo/demo_msgs/msg/demo_shm.h"

#include "shm_plc_demo/shmgen_client.h"
#include "shm_plc_demo/shmgen_notifier.h"
#include "shm_plc_demo/shmgen_server.h"

#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>

#define HOLDS(condition) ((condition) ? (void)0 : (printf("%d: %s\n", __LINE__, #condition), exit(1)))

enum { LARGE = 4096 };
static const char *topic;
static const shmgen_type large = {"demo_msgs/msg/Large", NULL, 1, LARGE, 0, 0, 0};
static shm_demo_msgs_Demo_publisher publisher;
static shm_demo_msgs_Demo_subscriber subscriber;
static shmgen_subscriber other;
static shm_demo_msgs_Demo message;
static const uint32_t none = 0;

static void open_both(uint32_t depth)
{
    const shmgen_options options = {.depth = depth};
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_OK);
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_OK);
}

static void publish(uint32_t a)
{
    message.a = a;
    HOLDS(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_OK);
}

static shmgen_status again(void)
{
    static shm_demo_msgs_Demo_publisher late;
    return shm_demo_msgs_Demo_publisher_open(&late, topic, NULL);
}

static pid_t child_that(void (*does)(void))
{
    const pid_t child = fork();
    if (child != 0)
        return child;
    does();
    _exit(0);
}

/* --- begin, complete ------------------------------------------------------------------------------------------- */

static void begin_comes_before_complete(void)
{
    void *payload, *second;
    open_both(1);
    HOLDS(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    HOLDS(shmgen_publisher_begin(&publisher.end, 0, &payload) == SHMGEN_OK);
    HOLDS(shmgen_publisher_begin(&publisher.end, 0, &second) == SHMGEN_MISUSED);
    HOLDS(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_MISUSED);
    memcpy(payload, &message, sizeof message);
    HOLDS(shmgen_publisher_complete(&publisher.end) == SHMGEN_OK);
    HOLDS(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    HOLDS(shmgen_publisher_enter(&publisher.end, 0) == SHMGEN_OK);
    HOLDS(shmgen_publisher_begin(&publisher.end, 0, &payload) == SHMGEN_OK); /* the lock is held already */
    shmgen_publisher_cancel(&publisher.end);
    HOLDS(shmgen_publisher_complete(&publisher.end) == SHMGEN_MISUSED);
    HOLDS(publisher.end.sequence == 1 && shmgen_load(&publisher.end.end, SHMGEN_AT(completed0)) == 1);
    HOLDS(shmgen_tokens(publisher.end.end.lock) == 1);
}

/* --- waiting --------------------------------------------------------------------------------------------------- */

static void overwrite(void)
{
    const size_t slot = shmgen_find(&other.end, shmgen_newest(&other.end));
    if (slot != 0)
        shmgen_store(&other.end, slot + offsetof(shmgen_slot, number), 0);
}

static void a_wait_leaves_the_message_or_says_so(void)
{
    static unsigned char before[LARGE], into[LARGE];
    static shmgen_publisher writer;
    shm_demo_msgs_Demo small = {.a = 7};
    memset(before, 0xAA, LARGE);
    memset(into, 0xAA, LARGE);
    HOLDS(shmgen_publisher_open(&writer, topic, &large, NULL) == SHMGEN_OK);
    HOLDS(shmgen_subscriber_open(&other, topic, &large, NULL) == SHMGEN_OK);
    HOLDS(shmgen_subscriber_wait(&other, into, LARGE, SHMGEN_MS, NULL) == SHMGEN_NOTHING_NEW);
    HOLDS(memcmp(into, before, LARGE) == 0);
    HOLDS(shmgen_publisher_write(&writer, before, LARGE, 0) == SHMGEN_OK);
    meanwhile = overwrite;
    HOLDS(shmgen_subscriber_wait(&other, into, LARGE, 5 * SHMGEN_MS, NULL) == SHMGEN_OVERWRITTEN);
    shmgen_publisher_close(&writer);
    HOLDS(shm_unlink(other.end.name) == 0);
    shmgen_subscriber_close(&other);
    meanwhile = NULL;
    open_both(1);
    publish(1);
    other = subscriber.end;
    meanwhile = overwrite;
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &small, 5 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    HOLDS(small.a == 7);
}

static void publish_late(void)
{
    shmgen_pause(20 * SHMGEN_MS);
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    publish(5);
    publish(6);
}

static void a_wait_lasts_for_ever(void)
{
    pid_t child;
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    child = child_that(publish_late);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_OK);
    HOLDS(message.a == 5 || message.a == 6);
    HOLDS(waitpid(child, NULL, 0) == child);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MIN) != SHMGEN_CLOSED); /* 6, or nothing */
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
    HOLDS(sigaction(SIGUSR1, &action, NULL) == 0);
    open_both(1);
    HOLDS(shmgen_subscriber_open(&other, topic, &subscriber.end.end.type, NULL) == SHMGEN_OK);
    child = child_that(signal_the_parent);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_STOPPED);
    HOLDS(waitpid(child, NULL, 0) == child);
    HOLDS(shmgen_ready_any(both, 2, INT64_MAX) == SHMGEN_STOPPED);
    publish(1);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_STOPPED);
    HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK); /* reading does not wait */
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, INT64_MAX) == SHMGEN_OK);
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
    HOLDS(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    HOLDS(shmgen_notifier_add(&notifier, &other) == SHMGEN_CLOSED);
    HOLDS(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK);
    HOLDS(is_readable(&notifier, 5000)); /* of the sample that is there already */
    HOLDS(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
    HOLDS(!is_readable(&notifier, 20)); /* once, although nobody has read it */
    for (uint32_t a = 2; a < 100; a++) {
        publish(a);
        HOLDS(is_readable(&notifier, 5000));
        HOLDS(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
        HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK && message.a == a);
    }
    shmgen_notifier_remove(&notifier, &subscriber.end);
    publish(100);
    HOLDS(!is_readable(&notifier, 30) && shmgen_notifier_next(&notifier) == NULL);
    HOLDS(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK && is_readable(&notifier, 5000));
    shmgen_notifier_close(&notifier);
    shmgen_notifier_close(&notifier);
    HOLDS(shmgen_notifier_fd(&notifier) == -1);
    HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK && message.a == 100);
}

static void a_notifier_outlives_a_region(void)
{
    static shmgen_notifier notifier;
    open_both(1);
    HOLDS(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    HOLDS(shmgen_notifier_add(&notifier, &subscriber.end) == SHMGEN_OK);
    HOLDS(shm_unlink(subscriber.end.end.name) == 0 && is_readable(&notifier, 5000));
    HOLDS(shmgen_notifier_next(&notifier) == &subscriber.end && shmgen_notifier_next(&notifier) == NULL);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    shm_demo_msgs_Demo_publisher_close(&publisher);
    HOLDS(is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) == &subscriber.end); /* again and again */
    open_both(1);
    while (shmgen_notifier_next(&notifier) == NULL)
        HOLDS(is_readable(&notifier, 5000));
    HOLDS(shmgen_notifier_next(&notifier) == NULL);
    publish(1);
    HOLDS(is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) == &subscriber.end);
    shm_demo_msgs_Demo_subscriber_close(&subscriber); /* its view of the region is its own */
    publish(2);
    HOLDS(is_readable(&notifier, 5000));
    shmgen_notifier_close(&notifier);
}

static void a_notifier_watches_more_than_one_sleep_takes(void)
{
    static shmgen_notifier notifier;
    static shmgen_subscriber many[SHMGEN_MOST_WAITS + 20];
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    HOLDS(shmgen_notifier_open(&notifier) == SHMGEN_OK);
    for (size_t index = 0; index < sizeof many / sizeof *many; index++) {
        HOLDS(shmgen_subscriber_open(&many[index], topic, &subscriber.end.end.type, NULL) == SHMGEN_OK);
        HOLDS(shmgen_notifier_add(&notifier, &many[index]) == SHMGEN_OK);
    }
    publish(1);
    for (size_t found = 0; found < sizeof many / sizeof *many;)
        if (is_readable(&notifier, 5000) && shmgen_notifier_next(&notifier) != NULL)
            found++;
    HOLDS(shmgen_notifier_next(&notifier) == NULL);
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
    shmgen_interface carries;
    memset(&carries, 0, sizeof carries);
    carries.request = carries.response = shmgen_part_of(large, NULL, NULL);
    memset(bytes, 0, sizeof bytes);
    HOLDS(shmgen_client_open(&client, topic, &carries, NULL) == SHMGEN_OK);
    HOLDS(pthread_create(&thread, NULL, stop_client, &client) == 0);
    HOLDS(shmgen_client_call(&client, bytes, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED);
    HOLDS(pthread_join(thread, NULL) == 0);
    shmgen_client_close(&client);
    HOLDS(shmgen_client_open(&client, topic, &carries, NULL) == SHMGEN_OK);
    HOLDS(shmgen_server_open(&server, topic, &carries, NULL) == SHMGEN_OK);
    HOLDS(pthread_create(&thread, NULL, stop_client, &client) == 0);
    HOLDS(shmgen_client_call(&client, bytes, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED); /* with a server that is slow */
    HOLDS(pthread_join(thread, NULL) == 0);
    HOLDS(shmgen_server_wait(&server, bytes, LARGE, 0) == SHMGEN_OK);
    HOLDS(pthread_create(&thread, NULL, stop_server, &server) == 0);
    HOLDS(shmgen_server_wait(&server, bytes, LARGE, INT64_MAX) == SHMGEN_STOPPED);
    HOLDS(pthread_join(thread, NULL) == 0);
    shmgen_server_close(&server);
    shmgen_client_close(&client);
}

static void many_topics_wake_one(void)
{
    static shmgen_publisher writer;
    char second[300];
    shmgen_subscriber *several[2] = {&subscriber.end, &other};
    open_both(1);
    snprintf(second, sizeof second, "%s_second", topic);
    HOLDS(shmgen_subscriber_open(&other, second, &large, NULL) == SHMGEN_OK);
    HOLDS(shmgen_publisher_open(&writer, second, &large, NULL) == SHMGEN_OK);
    HOLDS(shmgen_ready_any(NULL, 0, 2 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    HOLDS(shmgen_ready_any(several, 2, 2 * SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    HOLDS(shmgen_load(&other.end, SHMGEN_AT(armed)) == 1 && shmgen_load(&subscriber.end.end, SHMGEN_AT(armed)) == 1);
    publish(1);
    HOLDS(shmgen_ready_any(several, 2, INT64_MAX) == SHMGEN_OK);
    HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OK);
    HOLDS(shmgen_ready_any(several, 2, 0) == SHMGEN_NOTHING_NEW);
    shmgen_subscriber_close(&other);
    HOLDS(shmgen_ready_any(several, 2, 0) == SHMGEN_CLOSED);
}

static void armed_is_cleared(void)
{
    open_both(1);
    shmgen_store(&publisher.end.end, SHMGEN_AT(armed), 1); /* by a reader that died waiting */
    publish(1);
    HOLDS(shmgen_load(&publisher.end.end, SHMGEN_AT(armed)) == 0);
}

/* --- reading --------------------------------------------------------------------------------------------------- */

static void void_the_sample(void)
{
    shmgen_store(&other.end, shmgen_slot_of(&other.end, 1, 0) + offsetof(shmgen_slot, number), none);
}

static void a_sample_voided_in_the_copy_is_none(void)
{
    open_both(3);
    publish(1);
    other = subscriber.end;
    meanwhile = void_the_sample;
    HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_OVERWRITTEN);
    HOLDS(subscriber.end.sequence == 0);
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
    int how;
    open_both(3);
    HOLDS(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_NOTHING_NEW);
    HOLDS(shmgen_subscriber_return(&subscriber.end) == SHMGEN_MISUSED);
    publish(1);
    publish(2);
    HOLDS(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK);
    HOLDS(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_MISUSED);
    memcpy(&a, payload, sizeof a);
    publish(3); /* goes elsewhere */
    HOLDS(waitpid(child_that(borrow_in_child), &how, 0) > 0 && how == 0);
    HOLDS(shmgen_subscriber_return(&subscriber.end) == SHMGEN_OK && a == 2);
    HOLDS(subscriber.end.sequence == 2 && subscriber.end.missed == 1 && shmgen_subscriber_age(&subscriber.end) >= 0);
    HOLDS(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK);
    for (a = 4; a <= 7; a++) /* the last into its slot */
        publish(a);
    HOLDS(shmgen_subscriber_return(&subscriber.end) == SHMGEN_OVERWRITTEN);
    HOLDS(subscriber.end.sequence == 2 && shmgen_tokens(subscriber.end.end.lock) == 1);
    HOLDS(shmgen_subscriber_borrow(&subscriber.end, &payload) == SHMGEN_OK && memcmp(payload, &message, sizeof a) == 0);
    shm_demo_msgs_Demo_subscriber_close(&subscriber);
    HOLDS(shmgen_subscriber_return(&subscriber.end) == SHMGEN_CLOSED);
}

static void who_is_passive_changes_nothing(void)
{
    const shmgen_options options = {.passive = 1};
    static unsigned char before[8192];
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_REGION_MISSING);
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, &options) == SHMGEN_OK);
    for (uint32_t a = 1; a <= 3; a++)
        publish(a);
    HOLDS(subscriber.end.end.size <= sizeof before);
    memcpy(before, publisher.end.end.base, subscriber.end.end.size);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, SHMGEN_MS) == SHMGEN_OK && message.a == 3);
    HOLDS(shm_demo_msgs_Demo_subscriber_wait(&subscriber, &message, SHMGEN_MS) == SHMGEN_NOTHING_NEW);
    HOLDS(subscriber.end.missed == 2);
    HOLDS(memcmp(before, publisher.end.end.base, subscriber.end.end.size) == 0);
    HOLDS(subscriber.end.end.lock == NULL && subscriber.end.end.event == NULL);
}

static void figures_have_names(void)
{
    open_both(1);
    message.tail_count = 9;
    HOLDS(shm_demo_msgs_Demo_publisher_publish(&publisher, &message) == SHMGEN_COUNT_EXCEEDED);
    HOLDS(strcmp(shmgen_publisher_rejected(&publisher.end), "tail") == 0 && shmgen_publisher_refused(&publisher.end) == 1);
    HOLDS(shmgen_publisher_write(&publisher.end, &message, sizeof message, 0) == SHMGEN_OK); /* nothing looks into it */
    HOLDS(shm_demo_msgs_Demo_subscriber_read(&subscriber, &message) == SHMGEN_COUNT_EXCEEDED);
    HOLDS(strcmp(shmgen_subscriber_rejected(&subscriber.end), "tail") == 0 && shmgen_subscriber_refused(&subscriber.end) == 1);
    HOLDS(sem_trywait(publisher.end.end.lock) == 0);
    message.tail_count = 0;
    HOLDS(shm_demo_msgs_Demo_publisher_try_publish(&publisher, &message) == SHMGEN_OK || !SHMGEN_KEEPS_ORDER);
    HOLDS(shmgen_publisher_lock_misses(&publisher.end) == 1 && shmgen_subscriber_lock_misses(&subscriber.end) == 0);
}

/* --- opening --------------------------------------------------------------------------------------------------- */

static void a_mode_in_decimal_is_refused(void)
{
    shmgen_options options = {.mode = 660};
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_MODE_INVALID);
    options.mode = 0640;
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, &options) == SHMGEN_OK);
}

static void who_makes_a_header_looks_again(void)
{
    const uint64_t digest = 1;
    shmgen_status status = shm_demo_msgs_Demo_subscriber_start(&subscriber, topic, NULL);
    for (int left = 1000; status == SHMGEN_OPENING && subscriber.end.end.step != SHMGEN_STEP_SETTLE && left > 0; left--)
        status = shmgen_subscriber_step(&subscriber.end);
    HOLDS(subscriber.end.end.step == SHMGEN_STEP_SETTLE);
    memcpy(subscriber.end.end.base + SHMGEN_AT(digest), &digest, sizeof digest); /* a PLC has made one too, of another layout */
    while (status == SHMGEN_OPENING)
        status = shmgen_subscriber_step(&subscriber.end);
    HOLDS(status == SHMGEN_OK && subscriber.end.end.attempts == 1); /* it is left to the PLC, which sees `retired` */
}

static void who_takes_over_confirms_it(void)
{
    shmgen_link *end = &publisher.end.end;
    shmgen_status status;
    HOLDS(shm_demo_msgs_Demo_subscriber_open(&subscriber, topic, NULL) == SHMGEN_OK);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(writer), SHMGEN_PLC); /* one that has stopped */
    status = shm_demo_msgs_Demo_publisher_start(&publisher, topic, NULL);
    while (status == SHMGEN_OPENING && end->step != SHMGEN_STEP_CONFIRM) {
        status = shmgen_publisher_step(&publisher.end);
        end->since -= end->step == SHMGEN_STEP_WATCH ? 2 * SHMGEN_CLAIM_MS * SHMGEN_MS : 0;
    }
    HOLDS(end->step == SHMGEN_STEP_CONFIRM && shmgen_load(end, SHMGEN_AT(writer)) == end->pid);
    shmgen_store(&subscriber.end.end, SHMGEN_AT(writer), SHMGEN_PLC); /* a second has begun meanwhile */
    while (status == SHMGEN_OPENING)
        status = shmgen_publisher_step(&publisher.end);
    HOLDS(status == SHMGEN_WRITER_IN_USE);
}

static void who_takes_over_spares_the_newest(void)
{
    shmgen_link *end = &publisher.end.end;
    open_both(1);
    publish(1);
    publish(2);
    publish(3);
    shmgen_store(end, shmgen_completed(1), 4); /* the newest, in the lane that is not this one's */
    shmgen_begin_turn(&publisher.end);
    HOLDS(shmgen_finish_claim(&publisher.end) == SHMGEN_OK);
    HOLDS(publisher.end.turn == 2 && publisher.end.sequence == 6 && shmgen_load(end, SHMGEN_AT(left)) == 6);
    publish(4);
    HOLDS(publisher.end.sequence == 7 && shmgen_newest(end) == 7);
}

/* --- forks ----------------------------------------------------------------------------------------------------- */

static void touch_nothing(void)
{
    for (;;)
        pause();
}

static void close_what_is_not_ours(void)
{
    shm_demo_msgs_Demo_publisher_close(&publisher);
}

static void a_forked_child_holds_no_claim(void)
{
    pid_t child;
    shmgen_status status;
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    child = child_that(touch_nothing);
    shm_demo_msgs_Demo_publisher_close(&publisher);
    status = again();
    kill(child, SIGKILL);
    HOLDS(waitpid(child, NULL, 0) == child && status == SHMGEN_OK);
}

static void a_forked_child_releases_no_claim(void)
{
    pid_t child;
    HOLDS(shm_demo_msgs_Demo_publisher_open(&publisher, topic, NULL) == SHMGEN_OK);
    child = child_that(close_what_is_not_ours);
    HOLDS(waitpid(child, NULL, 0) == child && again() == SHMGEN_WRITER_IN_USE);
    publish(1);
}

#define CASE(name) {#name, name}
static const struct {
    const char *name;
    void (*run)(void);
} cases[] = {
    CASE(begin_comes_before_complete), CASE(a_wait_leaves_the_message_or_says_so), CASE(a_wait_lasts_for_ever),
    CASE(a_notifier_reports_each_sample), CASE(a_notifier_outlives_a_region),
    CASE(a_notifier_watches_more_than_one_sleep_takes),
    CASE(a_signal_handler_ends_a_wait), CASE(another_thread_ends_a_call), CASE(many_topics_wake_one), CASE(armed_is_cleared), CASE(a_sample_voided_in_the_copy_is_none),
    CASE(a_sample_is_read_in_place), CASE(who_is_passive_changes_nothing), CASE(figures_have_names),
    CASE(a_mode_in_decimal_is_refused), CASE(who_makes_a_header_looks_again), CASE(who_takes_over_confirms_it),
    CASE(who_takes_over_spares_the_newest),
    CASE(a_forked_child_holds_no_claim), CASE(a_forked_child_releases_no_claim),
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
