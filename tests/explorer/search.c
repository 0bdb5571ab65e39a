/* Run all schedules of a scene. Each schedule starts at the first step, and ends early if it repeats a known state.
 * Usage: `explore SETTING=NUMBER ... "ENDPOINT SETTING=NUMBER ..." ...`, with one or more endpoints.
 *
 * The settings `p`, `c` and `s` are the largest numbers of pre-emptions, crashes and stalls in a schedule. `b` is
 * the largest number of steps before which stores are held back in store buffers. The setting `seconds` limits the processor time, and `ms`
 * the simulated time. Without a table of states, `table` is 0; `bits` is the size of the table. With `end_states=1`, the
 * program counts different end states. With `replay=SCHEDULE`, it runs only this schedule. Endpoints read all other
 * settings. The program prints one line of JSON and, if a check fails, also the steps. */
#include "explorer.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define DEEPEST 100000

static struct { uint8_t chosen, count; } choices[DEEPEST];
static int depth, fixed; /* number of choices made; the first `fixed` choices repeat the previous schedule */
static bool cut, without_table, is_replay;
static const char *replayed;
static char schedule[4096];
static uint64_t mask, *table, *end_states_seen;
static long states, end_states;

uint64_t mix(uint64_t hash, uint64_t value)
{
    hash ^= value + UINT64_C(0x9E3779B97F4A7C15) + (hash << 6) + (hash >> 2);
    hash *= UINT64_C(0xff51afd7ed558ccd);
    return hash ^ (hash >> 32);
}

/* --- the table of states ----------------------------------------------------------------------------------- */

/* Return true if the table does not contain the hash, and add the hash if the table is not full. */
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

/* Return true if an earlier choice had the same state, the same options and the same remaining budgets. */
static bool is_known_state(const option *options, int count)
{
    uint64_t hash = mix(state_hash(), (uint64_t)self);
    for (int i = 0; i < BUDGETS; i++)
        hash = mix(hash, (uint64_t)left[i]);
    for (int i = 0; i < count; i++)
        hash = mix(hash, (uint64_t)(options[i].kind * 256 + options[i].which));
    return !is_new(table, hash, &states);
}

/* --- choices ----------------------------------------------------------------------------------------------- */

/* Add a choice to the schedule, except a first option. Before step 12 of A, "A12>B": B continues; "A12!": A crashes;
 * "A12~": A stalls; "A12&2": two stores of A stay in its buffer; "A12*C": A wakes only C. */
static void note_choice(option chosen)
{
    const bool actor = chosen.kind != '&';
    char text[40];
    int length = snprintf(text, sizeof text, "%s%c%ld%c", *schedule ? " " : "", 'A' + self, steps_of(self), chosen.kind);
    if (chosen.kind != '!' && chosen.kind != '~')
        snprintf(text + length, sizeof text - (size_t)length, actor ? "%c" : "%d", actor ? 'A' + chosen.which : chosen.which);
    if (strlen(schedule) + strlen(text) < sizeof schedule)
        strcat(schedule, text);
}

/* Return the option that the replayed schedule contains for this step, or 0, the first option. */
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
    int chosen = 0;
    if (count < 2)
        return options[0];
    if (is_replay) {
        chosen = replay(options, count);
    } else if (depth < fixed) {
        chosen = choices[depth++].chosen;
    } else {
        if (!without_table && !printing && is_known_state(options, count)) {
            cut = true;
            end_schedule();
        }
        if (depth >= DEEPEST) {
            fprintf(stderr, "a schedule has more than %d choices\n", DEEPEST);
            exit(2);
        }
        choices[depth].count = (uint8_t)count;
        choices[depth].chosen = 0;
        fixed = ++depth;
    }
    if (chosen != 0)
        note_choice(options[chosen]);
    return options[chosen];
}

/* Start the next schedule: at the last choice with an untried option, select this option. Return false after the last. */
static bool next_schedule(void)
{
    for (fixed = depth; fixed > 0 && choices[fixed - 1].chosen + 1 >= choices[fixed - 1].count;)
        fixed--;
    if (fixed == 0)
        return false;
    choices[fixed - 1].chosen++;
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
    if (end_states_seen != NULL)
        is_new(end_states_seen, state_hash(), &end_states);
    without_steps = true;
    check_end_state();
    without_steps = false;
    return steps;
}

static double seconds_used(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

/* Read the settings and add the actors of the command line. Return the limit of processor time. */
static double read_settings(int count, char **texts)
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
        else if (strncmp(text, "end_states=", 11) == 0)
            end_states_seen = (uint64_t *)value;
        else if (strncmp(text, "replay=", 7) == 0)
            is_replay = true, replayed = value + 1;
        else
            strcat(strcat(scene_settings, " "), text);
    }
    mask = (UINT64_C(1) << bits) - 1;
    table = calloc(mask + 1, sizeof *table);
    end_states_seen = end_states_seen ? calloc(mask + 1, sizeof *table) : NULL;
    for (int i = 1; i < count; i++)
        if (strchr(texts[i], '=') == NULL || memchr(texts[i], ' ', strcspn(texts[i], "=")) != NULL)
            add_actor(texts[i]);
    return seconds;
}

int main(int count, char **texts)
{
    const double seconds = read_settings(count, texts);
    bool complete = false;
    long runs = 0, cuts = 0, steps = 0;
    printing = is_replay;
    for (bool more = true; more && *failure == 0; runs++) {
        steps += run_once();
        cuts += cut;
        complete = is_replay || (*failure == 0 && !next_schedule());
        more = !complete && ((runs & 255) != 0 || seconds_used() < seconds);
    }
    printf("{\"found\": \"%s\", \"schedule\": \"%s\", \"complete\": %s, \"schedules\": %ld, \"cut\": %ld, \"states\": %ld, "
           "\"steps\": %ld, \"seconds\": %.2f, \"end_states\": %ld, \"full\": %s}\n",
        failure, *failure ? schedule : "", complete ? "true" : "false", runs, cuts, states, steps, seconds_used(), end_states,
        (uint64_t)states >= mask / 8 * 7 ? "true" : "false");
    if (*failure != 0 && !is_replay) { /* run the schedule again and print each step */
        printing = true;
        fixed = depth;
        run_once();
    }
    without_steps = true; /* the blocks close their regions when the program ends */
    return 0;
}
