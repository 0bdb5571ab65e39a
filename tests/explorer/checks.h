/* Checks of samples and calls. A message consists of two equal words. Different words mark a torn sample. */
#ifndef CHECKS_H
#define CHECKS_H

#include "explorer.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TOPIC "/t"
#define SERVICE "/s"

uint64_t new_content(void); /* a different value for each message */
void note_published(uint32_t number, uint64_t content); /* after the writer completed the sample */
void check_sample(uint32_t number, uint64_t a, uint64_t b);
bool is_later(uint32_t number, uint32_t than); /* numbers wrap around */
uint32_t newest_published(void); /* 0: none */
int64_t since_published(uint32_t number); /* age in ns; 0 before the writer completed the sample */
uint32_t received_by(int actor); /* number of samples */
uint64_t new_request(void);
uint64_t take_request(uint64_t a, uint64_t b); /* a server may take a request once; returns the response */
void check_response(uint64_t request, uint64_t a, uint64_t b);
uint64_t response_count(void);
void set_up_calls(void);
void start_client(void); /* waits for start=MS; removes=1: removes the request region */
void plc_writes_before(int samples, uint32_t number); /* a PLC writes samples before the scene; the last has `number` */

#ifdef __cplusplus
}
#endif

#endif
