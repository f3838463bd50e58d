@about@
#ifndef EUPNEA_H
#define EUPNEA_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Control period, microseconds: call eupnea_step() once in each. */
#define EUPNEA_PERIOD_US @period_us@u

/* Settings of a breath, with their allowed range. */
typedef struct {
@settings@
} eupnea_settings;

/* What eupnea_start_breath() answers. */
enum {
  EUPNEA_ACCEPTED = 0,
  EUPNEA_OUT_OF_RANGE = 1,     /* A setting is outside its range, or not a number. */
  EUPNEA_PIP_TOO_LOW = 2,      /* PIP is less than @least_rise@ cmH2O above PEEP. */
  EUPNEA_LIMIT_TOO_LOW = 3,    /* The pressure limit is less than @limit_margin@ cmH2O above PIP. */
  EUPNEA_BREATH_TOO_SHORT = 4  /* Inspiration and fall do not fit into a breath. */
};

/* Command of one tick. */
typedef struct {
  float u_in;    /* Opening of the inspiratory valve, percent, 0 to 100. */
  int u_out;     /* Whether the expiratory valve is open. */
  float target;  /* Target pressure of the tick, cmH2O. */
} eupnea_command;

/* Past of a signal: a ring of its last values, and leaky averages. */
typedef struct {
  float ring[@history@];
  float averages[@averages@];
} eupnea_history;

/* Mean error and command over the time of an inspiration, bin by bin. */
typedef struct {
  float bins[@bins@][2];
  uint32_t filled;
} eupnea_profile;

/* State of a controller. Its content belongs to the functions below. */
typedef struct {
  eupnea_settings settings;
  uint32_t rise_ticks, inspiration_ticks, fall_ticks, total_ticks, tick;
  uint8_t breathes, inspires, disturbed, cut;
  float last_command, learned;
  float integral, derivative, last_pressure;
  uint8_t has_pressure;
  eupnea_history errors, commands;
  uint32_t now;
  eupnea_profile profiles[2];
  uint8_t mean, finite, adopted;
  float sums[2];
  uint32_t summed, width;
  float difference;
} eupnea_state;

/* Empties the state: nothing remembered, no breath, valves safe. */
void eupnea_init(eupnea_state *state);

/* Starts a breath. The memory of earlier breaths survives a small step of PIP or PEEP only. Answers EUPNEA_ACCEPTED, or why the
   settings are refused; then the running breath goes on. */
int eupnea_start_breath(eupnea_state *state, const eupnea_settings *settings);

/* One tick with the airway pressure in cmH2O, in every phase of the breath. Without a breath, and in a tick whose reading is not a
   number or beyond the sensor's range, the valves are safe: u_in is 0, u_out is 1. */
eupnea_command eupnea_step(eupnea_state *state, float pressure);

/* Whether the breath has lasted its time, so that the next one is due. */
int eupnea_is_due(const eupnea_state *state);

/* Says that something has disturbed the running inspiration, such as a patient's effort or a command that you changed: it is not
   remembered. */
void eupnea_disturb(eupnea_state *state);

/* Repeats computations whose results are known, and compares every bit; leaves an empty state. Answers 0 if all are the same, 1 if
   the weights' own test differs, otherwise 2 plus the number of the first breath that differs. Do not use a controller that
   differs. It takes as long as @check_ticks@ ticks: run it before the first breath. */
int eupnea_self_check(eupnea_state *state);

#ifdef __cplusplus
}
#endif
#endif
