/* What must hold for samples, whoever writes and reads them. A message is two words, equal in a whole one. */
#ifndef CHECKS_H
#define CHECKS_H

#include "explorer.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TOPIC "/t"
#define SERVICE "/s"

uint64_t new_content(void);                          /* of the next message, another each time */
void published(uint32_t number, uint64_t content);   /* the writer was told that it is complete */
void received(uint32_t number, uint64_t a, uint64_t b);
bool is_later(uint32_t number, uint32_t than);       /* numbers wrap around */
uint32_t newest_published(void);                     /* 0: none */
int64_t since_published(uint32_t number);            /* ns; of one that nobody was told of 0 */
uint32_t received_by(int actor);                     /* how many */
uint64_t new_question(void);
uint64_t taken(uint64_t a, uint64_t b); /* by a server, once; returns the answer */
void answered(uint64_t question, uint64_t a, uint64_t b);
uint64_t answers(void); /* how many came */
void set_up_calls(void);
void start_client(void); /* waits for start=MS; removes=1: removes the region of the requests, and begins a fresh one */
void plc_was_here(int samples, uint32_t number);     /* a PLC wrote so many, up to that number, and stopped */

#ifdef __cplusplus
}
#endif

#endif
