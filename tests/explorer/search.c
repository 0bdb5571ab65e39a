/* Goes through all schedules of a scene: each is run from its start, and cut off where it comes to a state seen before.
 *
 *     explore SETTING=NUMBER ... "END SETTING=NUMBER ..." ...
 *
 * p, c, s: pre-emptions, crashes and stalls that a schedule may have; b: steps past stores that are not out yet, with
 * store buffers then. seconds, ms (a bound on the scene's own time), table=0, bits (of the table), ends=1 (how many
 * different ends there are), replay=SCHEDULE. What else is set is for the ends. Prints one line of JSON, then the schedule.
 */
#include "explorer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define DEEPEST 100000

static struct { uint8_t taken, count; } choices[DEEPEST];
static int depth, fixed;
static bool cut, without_table, replays;
static const char *replayed;
static char schedule[4096];
static uint64_t mask, *table, *ends_seen;
static long states, ends;

uint64_t mixed(uint64_t hash, uint64_t value)
{
    hash ^= value + UINT64_C(0x9E3779B97F4A7C15) + (hash << 6) + (hash >> 2);
    hash *= UINT64_C(0xff51afd7ed558ccd);
    return hash ^ (hash >> 32);
}

/* --- the table of states ----------------------------------------------------------------------------------- */

/* Whether it is not in that table; a full one takes nothing more. */
static bool is_new(uint64_t *in, uint64_t hash, long *count)
{
    hash |= 1;
    for (uint64_t at = hash >> 8 & mask;; at = (at + 1) & mask) {
        if (in[at] == hash)
            return false;
        if (in[at] == 0) {
            if ((uint64_t)*count < mask / 8 * 7) {
                in[at] = hash;
                ++*count;
            }
            return true;
        }
    }
}

/* The state, which choice is to be made, and what may still happen. */
static bool was_here(const option *options, int count)
{
    uint64_t hash = mixed(state_hash(), (uint64_t)self);
    for (int i = 0; i < BUDGETS; i++)
        hash = mixed(hash, (uint64_t)left[i]);
    for (int i = 0; i < count; i++)
        hash = mixed(hash, (uint64_t)(options[i].kind * 256 + options[i].which));
    return !is_new(table, hash, &states);
}

/* --- choices ----------------------------------------------------------------------------------------------- */

/* A choice other than the first, as text: who was about to take which of its steps, and what came. "A12>B": B went on,
 * "A12!": A crashed, "A12~": A stood still, "A12&2": two of A's stores stayed, "A12*C": C was woken and no other. */
static void note_choice(option taken)
{
    const bool actor = taken.kind != '&';
    char text[40];
    int length = snprintf(text, sizeof text, "%s%c%ld%c", *schedule ? " " : "", 'A' + self, steps_of(self), taken.kind);
    if (taken.kind != '!' && taken.kind != '~')
        snprintf(text + length, sizeof text - (size_t)length, actor ? "%c" : "%d", actor ? 'A' + taken.which : taken.which);
    if (strlen(schedule) + strlen(text) < sizeof schedule)
        strcat(schedule, text);
}

/* Which option the schedule to be replayed names here; the first where it names none. */
static int replay(const option *options, int count)
{
    char actor, kind, which[8] = "";
    long at;
    int length = 0;
    if (sscanf(replayed, " %c%ld%c%n%7[^ ]%n", &actor, &at, &kind, &length, which, &length) < 3 ||
        actor != 'A' + self || at != steps_of(self))
        return 0;
    for (int i = 1; i < count; i++)
        if (options[i].kind == kind && (*which == 0 || options[i].which == (kind == '&' ? atoi(which) : *which - 'A'))) {
            replayed += length;
            return i;
        }
    return 0;
}

option choose(const option *options, int count)
{
    int taken = 0;
    if (count < 2)
        return options[0];
    if (replays) {
        taken = replay(options, count);
    } else if (depth < fixed) {
        taken = choices[depth++].taken;
    } else {
        if (!without_table && !printing && was_here(options, count)) {
            cut = true;
            leave();
        }
        if (depth >= DEEPEST) {
            fprintf(stderr, "a schedule of more than %d choices\n", DEEPEST);
            exit(2);
        }
        choices[depth].count = (uint8_t)count;
        choices[depth].taken = 0;
        fixed = ++depth;
    }
    if (taken != 0)
        note_choice(options[taken]);
    return options[taken];
}

/* The next schedule: the last choice that has another option takes it. False: that was all. */
static bool next_schedule(void)
{
    for (fixed = depth; fixed > 0 && choices[fixed - 1].taken + 1 >= choices[fixed - 1].count;)
        fixed--;
    if (fixed == 0)
        return false;
    choices[fixed - 1].taken++;
    return true;
}

/* --- the search -------------------------------------------------------------------------------------------- */

static long run_once(void)
{
    long steps;
    depth = 0;
    cut = false;
    *schedule = 0;
    steps = run_actors();
    if (cut || *failure != 0)
        return steps;
    if (ends_seen != NULL)
        is_new(ends_seen, state_hash(), &ends);
    quiet = true;
    look_after();
    quiet = false;
    return steps;
}

static double seconds_used(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

/* Takes the settings of the command line over. */
static double settle_scene(int count, char **texts)
{
    static const char *const budgets[BUDGETS] = {"p=", "c=", "s=", "b="};
    double seconds = 60;
    int bits = 22;
    allowed[HOLDS] = -1;
    for (int i = 1; i < count; i++) {
        const char *text = texts[i], *value = strchr(text, '=');
        if (value == NULL || memchr(text, ' ', (size_t)(value - text)) != NULL)
            continue;
        for (int k = 0; k < BUDGETS; k++)
            if (strncmp(text, budgets[k], 2) == 0)
                allowed[k] = atoi(text + 2);
        if (strncmp(text, "seconds=", 8) == 0)
            seconds = atof(value + 1);
        else if (strncmp(text, "bits=", 5) == 0)
            bits = atoi(value + 1);
        else if (strncmp(text, "table=", 6) == 0)
            without_table = atoi(value + 1) == 0;
        else if (strncmp(text, "ends=", 5) == 0)
            ends_seen = (uint64_t *)value;
        else if (strncmp(text, "replay=", 7) == 0)
            replays = true, replayed = value + 1;
        else
            strcat(strcat(scene_settings, " "), text);
    }
    mask = (UINT64_C(1) << bits) - 1;
    table = calloc(mask + 1, sizeof *table);
    ends_seen = ends_seen ? calloc(mask + 1, sizeof *table) : NULL;
    for (int i = 1; i < count; i++)
        if (strchr(texts[i], '=') == NULL || memchr(texts[i], ' ', strcspn(texts[i], "=")) != NULL)
            add_actor(texts[i]);
    return seconds;
}

int main(int count, char **texts)
{
    const double seconds = settle_scene(count, texts);
    bool complete = false;
    long runs = 0, cuts = 0, steps = 0;
    printing = replays;
    for (bool more = true; more && *failure == 0; runs++) {
        steps += run_once();
        cuts += cut;
        complete = replays || (*failure == 0 && !next_schedule());
        more = !complete && ((runs & 255) != 0 || seconds_used() < seconds);
    }
    printf("{\"found\": \"%s\", \"schedule\": \"%s\", \"complete\": %s, \"schedules\": %ld, \"cut\": %ld, \"states\": %ld, "
           "\"steps\": %ld, \"seconds\": %.2f, \"ends\": %ld, \"full\": %s}\n",
        failure, *failure ? schedule : "", complete ? "true" : "false", runs, cuts, states, steps, seconds_used(), ends,
        (uint64_t)states >= mask / 8 * 7 ? "true" : "false");
    if (*failure != 0 && !replays) { /* once more, told step by step */
        printing = true;
        fixed = depth;
        run_once();
    }
    quiet = true; /* the blocks close what they hold when the program ends */
    return 0;
}
