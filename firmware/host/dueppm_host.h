/* The firmware on another computer than its board, with a model of the board; a C interface, for ctypes. Not
 * thread-safe: use a board in one thread at a time. */
#pragma once

#include <stddef.h>
#include <stdint.h>

#pragma GCC visibility push(default)
#ifdef __cplusplus
extern "C" {
#endif

struct dueppm_edge {
  uint64_t time_ticks; /* since dueppm_new; 42 per microsecond */
  int level;           /* of the output, from here on */
};

void* dueppm_new(void); /* with the shipped configuration, at time 0 */
void dueppm_free(void* board);
/* Like the reset button, now: everything but the time is reset, bytes on the line are lost. */
void dueppm_reset(void* board);
/* Gives the board bytes from the host computer; they arrive at the line's rate (57600 baud), one by one. */
void dueppm_receive(void* board, const uint8_t* bytes, size_t count);
/* Takes up to `most` bytes that the board has sent so far, also at the line's rate; returns their number. */
size_t dueppm_send(void* board, uint8_t* bytes, size_t most);
/* Runs loop() and the timer's interrupt up to that time. */
void dueppm_advance(void* board, uint64_t time_us);
/* Time [ticks] at which the newest accepted message was complete; 0: none yet. */
uint64_t dueppm_accepted(void* board);
/* Takes up to `most` edges of the output, oldest first; returns their number. If edges are not taken, the
 * newest 4096 are kept. */
size_t dueppm_edges(void* board, struct dueppm_edge* edges, size_t most);

#ifdef __cplusplus
}
#endif
#pragma GCC visibility pop
