/* Runs exported controllers on operations from the file operations.bin and writes what they answer to answers.bin, in words of the
   machine's order. On a chip in QEMU the files are those of the computer, by semihosting. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

/* Written by the test: includes the headers and lists the controllers. */
#include "controllers.h"

enum { INIT, START, STEP, DISTURB, CHECK };

static uint32_t words_of(uint32_t operation) { return operation == START ? 8 : operation == STEP ? 1 : 0; }

#define DEFINE(name)                                                                      \
  static name##_state name##_kept;                                                        \
  static void name##_run(uint32_t operation, const float *numbers, uint32_t answer[3]) {  \
    name##_settings settings;                                                             \
    name##_command command;                                                               \
    switch (operation) {                                                                  \
      case INIT:                                                                          \
        name##_init(&name##_kept);                                                        \
        break;                                                                            \
      case START:                                                                         \
        memcpy(&settings, numbers, sizeof settings);                                      \
        answer[0] = (uint32_t)name##_start_breath(&name##_kept, &settings);               \
        break;                                                                            \
      case STEP:                                                                          \
        command = name##_step(&name##_kept, *numbers);                                    \
        memcpy(&answer[0], &command.u_in, 4);                                             \
        answer[1] = (uint32_t)command.u_out | (uint32_t)name##_is_due(&name##_kept) << 1; \
        memcpy(&answer[2], &command.target, 4);                                           \
        break;                                                                            \
      case DISTURB:                                                                       \
        name##_disturb(&name##_kept);                                                     \
        break;                                                                            \
      default:                                                                            \
        answer[0] = (uint32_t)name##_self_check(&name##_kept);                            \
    }                                                                                     \
  }
CONTROLLERS(DEFINE)

#define ENTRY(name) name##_run,
static void (*const RUN[])(uint32_t, const float *, uint32_t *) = {CONTROLLERS(ENTRY)};

int main(void) {
  FILE *in = fopen("operations.bin", "rb"), *out = fopen("answers.bin", "wb");
  uint32_t head[2];
  float numbers[8];
  if (in == NULL || out == NULL) {
    return 1;
  }
  while (fread(head, sizeof head, 1, in) == 1) {
    uint32_t answer[3] = {0, 0, 0};
    const uint32_t words = words_of(head[1]);
    if (fread(numbers, 4, words, in) != words) {
      return 2;
    }
    RUN[head[0]](head[1], numbers, answer);
    if (fwrite(answer, sizeof answer, 1, out) != 1) {
      return 3;
    }
  }
  return fclose(out) == 0 ? 0 : 4;
}
