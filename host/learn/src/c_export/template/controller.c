@about@
#include "@stem@.h"

#include <float.h>

#if FLT_RADIX != 2 || FLT_MANT_DIG != 24 || DBL_MANT_DIG != 53
#error "float and double must have single and double precision (on AVR: -mdouble=64)"
#endif
#if !defined(FLT_EVAL_METHOD) || FLT_EVAL_METHOD != 0
#error "sums of floats must be rounded to floats (on 32-bit x86: -msse2 -mfpmath=sse)"
#endif
#ifdef __FAST_MATH__
#error "compile without -ffast-math, which changes the order of sums"
#endif

/* A product is rounded before it is added, so no fused operations. GCC does not know the standard's pragma. */
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif

/* Constants of the core. Units: cmH2O, percent, seconds, ticks. */
@constants@
/* Taps, factors and time constants of the features. */
@features@
/* Bins of a profile: number and width, in shortest bins. */
static const struct { uint32_t bins, width; } SECTIONS[] = {@sections@};

/* Middles of the bins: first one, in shortest bins since the middle of the first bin; its bin; bins per shortest bin. */
static const struct { float from; uint32_t bin; float rate; } PIECES[] = {@pieces@};

/* The network: one row of weights per input, then the biases. */
@network@
#define LENGTH(array) (sizeof(array) / sizeof((array)[0]))

enum phase { INSPIRATION, FALL, EXPIRATION };
enum lesson { ADOPT, DISCARD, FORGET };

typedef struct {
  float pressure, target, pip, peep;
  uint32_t tick, rise_ticks;
} observation;

/* The command with the learned part, and without it. */
typedef struct {
  float base, command;
} output;

/* Limits x; what is not a number becomes lo. */
static float limit(float x, float lo, float hi) {
  if (x >= lo) {
    return x <= hi ? x : hi;
  }
  return lo;
}

static float magnitude(float x) { return x < 0.0f ? -x : x; }

static int is_finite(float x) { return x - x == 0.0f; }

static int within(float x, float lo, float hi) { return x >= lo && x <= hi; }

/* --- The breath --- */

static uint32_t ticks(float seconds) {
  double exact = (double)seconds * 1.0e6 / (double)EUPNEA_PERIOD_US;
  return (uint32_t)(exact + 0.5);
}

static enum phase phase_of(const eupnea_state *state) {
  if (state->tick < state->inspiration_ticks) {
    return INSPIRATION;
  }
  return state->tick - state->inspiration_ticks < state->fall_ticks ? FALL : EXPIRATION;
}

/* Target of an inspiration without end. */
static float rising(float pip, float peep, uint32_t rise_ticks, uint32_t tick) {
  return tick < rise_ticks ? peep + (pip - peep) * ((float)tick / (float)rise_ticks) : pip;
}

static float target_of(const eupnea_state *state, enum phase phase) {
  const float pip = state->settings.pip, peep = state->settings.peep;
  switch (phase) {
    case INSPIRATION:
      return rising(pip, peep, state->rise_ticks, state->tick);
    case FALL:
      return pip + (peep - pip) * ((float)(state->tick - state->inspiration_ticks) / (float)state->fall_ticks);
    default:
      return peep;
  }
}

/* --- Memory of earlier breaths --- */

static uint32_t width_of(uint32_t bin) {
  uint32_t n;
  for (n = 0; n + 1 < LENGTH(SECTIONS) && bin >= SECTIONS[n].bins; n++) {
    bin -= SECTIONS[n].bins;
  }
  return SECTIONS[n].width;
}

static void begin_profile(eupnea_state *state) {
  state->profiles[!state->mean].filled = 0;
  state->sums[0] = state->sums[1] = 0.0f;
  state->summed = 0;
  state->width = SECTIONS[0].width;
  state->difference = 0.0f;
  state->finite = 1;
}

static void learn(eupnea_state *state, enum lesson lesson) {
  const uint32_t filled = state->profiles[!state->mean].filled;
  if (lesson == ADOPT) {
    if (!state->finite || filled < LEAST_BINS) {
      lesson = DISCARD;
    } else if (state->adopted >= LEARNING && state->difference >= SURPRISE * (float)filled) {
      lesson = FORGET;
    }
  }
  if (lesson == ADOPT) {
    if (state->adopted < LEARNING) {
      state->adopted++;
    }
    state->mean = !state->mean;
  } else if (lesson == FORGET) {
    state->adopted = 0;
    state->profiles[state->mean].filled = 0;
  }
  begin_profile(state);
}

/* Closes a bin of the running breath; beside it stands what is remembered. */
static void fill(eupnea_state *state, const float new_bin[2]) {
  const eupnea_profile *mean = &state->profiles[state->mean];
  eupnea_profile *running = &state->profiles[!state->mean];
  const uint32_t bin = running->filled;
  const int known = bin < mean->filled;
  int n;
  if (bin >= BINS) {
    return;
  }
  running->filled = bin + 1;
  state->width = width_of(bin + 1);
  state->finite = state->finite && is_finite(new_bin[0]) && is_finite(new_bin[1]);
  state->difference += magnitude(new_bin[0] - (known ? mean->bins[bin][0] : new_bin[0]));
  for (n = 0; n < 2; n++) {
    const float old = mean->bins[bin][n];
    running->bins[bin][n] = known ? old + NEWEST * (new_bin[n] - old) : new_bin[n];
  }
}

static void record(eupnea_state *state, float error, float command) {
  const uint32_t bin_ticks = BIN_TICKS * state->width;
  state->sums[0] += error;
  state->sums[1] += command;
  state->summed++;
  if (state->summed >= bin_ticks) {
    const float share = 1.0f / (float)bin_ticks;
    float bin[2];
    bin[0] = share * state->sums[0];
    bin[1] = share * state->sums[1];
    fill(state, bin);
    state->sums[0] = state->sums[1] = 0.0f;
    state->summed = 0;
  }
}

/* Remembered error (0) or command (1) of a bin; past what is remembered, that of the last bin. */
static float remembered(const eupnea_profile *mean, uint32_t bin, int signal) {
  return mean->bins[bin < mean->filled - 1 ? bin : mean->filled - 1][signal];
}

static float recalled_at(const eupnea_profile *mean, float time, int signal) {
  uint32_t n, piece = 0, whole;
  float bins, share, first, second;
  for (n = 1; n < LENGTH(PIECES); n++) {
    if (time >= PIECES[n].from) {
      piece = n;
    }
  }
  bins = (time - PIECES[piece].from) * PIECES[piece].rate;
  whole = (uint32_t)bins;
  share = bins - (float)whole;
  first = remembered(mean, PIECES[piece].bin + whole, signal);
  second = remembered(mean, PIECES[piece].bin + whole + 1, signal);
  return first + share * (second - first);
}

static void recall(const eupnea_state *state, uint32_t tick, float values[RECALLED]) {
  const eupnea_profile *mean = &state->profiles[state->mean];
  const float now = (float)(tick > BIN_TICKS / 2 ? tick - BIN_TICKS / 2 : 0) / (float)BIN_TICKS;
  uint32_t n;
  for (n = 0; n < RECALLED; n++) {
    values[n] = 0.0f;
  }
  if (mean->filled == 0) {
    return;
  }
  for (n = 0; n < LENGTH(ERRORS_AHEAD); n++) {
    *values++ = recalled_at(mean, now + ERRORS_AHEAD[n], 0);
  }
  for (n = 0; n < LENGTH(COMMANDS_AHEAD); n++) {
    *values++ = recalled_at(mean, now + COMMANDS_AHEAD[n], 1);
  }
  *values = 1.0f;
}

/* --- Features --- */

static void fill_history(eupnea_history *history, float value) {
  uint32_t n;
  for (n = 0; n < HISTORY; n++) {
    history->ring[n] = value;
  }
  for (n = 0; n < AVERAGES; n++) {
    history->averages[n] = value;
  }
}

static void push(eupnea_history *history, uint32_t at, float value, const float factors[AVERAGES]) {
  uint32_t n;
  history->ring[at % HISTORY] = value;
  for (n = 0; n < AVERAGES; n++) {
    history->averages[n] += factors[n] * (value - history->averages[n]);
  }
}

static void features(eupnea_state *state, const observation *seen, float values[FEATURES]) {
  const float time = (float)seen->tick * PERIOD;
  const float target = rising(seen->pip, seen->peep, seen->rise_ticks, seen->tick);
  uint32_t n;
  push(&state->errors, state->now, (seen->target - seen->pressure) / ERROR_SCALE, ERROR_FACTORS);
  for (n = 0; n < LENGTH(ERROR_TAPS); n++) {
    *values++ = state->errors.ring[(state->now - ERROR_TAPS[n]) % HISTORY];
  }
  for (n = 0; n < LENGTH(COMMAND_TAPS); n++) {
    *values++ = state->commands.ring[(state->now - COMMAND_TAPS[n]) % HISTORY];
  }
  for (n = 0; n < AVERAGES; n++) {
    *values++ = state->errors.averages[n];
  }
  for (n = 0; n < AVERAGES; n++) {
    *values++ = state->commands.averages[n];
  }
  *values++ = state->integral / COMMAND_SCALE;
  for (n = 0; n < LENGTH(TIMES); n++) {
    *values++ = time / (time + TIMES[n]);
  }
  *values++ = (seen->pip - PIP_ZERO) / PIP_SCALE;
  *values++ = (seen->peep - PEEP_ZERO) / PEEP_SCALE;
  for (n = 0; n < LENGTH(TARGET_AHEAD); n++) {
    const uint32_t then = seen->tick + TARGET_AHEAD[n];
    *values++ = (rising(seen->pip, seen->peep, seen->rise_ticks, then) - target) / ERROR_SCALE;
  }
}

/* --- Network --- */

/* Each sum starts with its bias and adds the inputs in order. */
static void dense(const float *weights, const float *bias, const float *x, uint32_t inputs, float *y, uint32_t outputs) {
  uint32_t i, o;
  for (o = 0; o < outputs; o++) {
    y[o] = bias[o];
  }
  for (i = 0; i < inputs; i++) {
    for (o = 0; o < outputs; o++) {
      y[o] += weights[i * outputs + o] * x[i];
    }
  }
}

static void softsign(float *x, uint32_t length) {
  uint32_t n;
  for (n = 0; n < length; n++) {
    x[n] = x[n] / (1.0f + magnitude(x[n]));
  }
}

static float network(const float inputs[INPUTS]) {
  float first[HIDDEN_1], second[HIDDEN_2], out;
  dense(WEIGHTS_1, BIAS_1, inputs, INPUTS, first, HIDDEN_1);
  softsign(first, HIDDEN_1);
  dense(WEIGHTS_2, BIAS_2, first, HIDDEN_1, second, HIDDEN_2);
  softsign(second, HIDDEN_2);
  dense(WEIGHTS_3, BIAS_3, second, HIDDEN_2, &out, 1);
  return out;
}

/* --- PID and residual --- */

static output pid(eupnea_state *state, const observation *seen, float extra) {
  const float error = seen->target - seen->pressure;
  const float change = state->has_pressure ? seen->pressure - state->last_pressure : 0.0f;
  float base, wanted;
  output commands;
  state->last_pressure = seen->pressure;
  state->has_pressure = 1;
  state->derivative += DERIVATIVE_FACTOR * (-DERIVATIVE_SCALE * change - state->derivative);
  base = PROPORTIONAL * error + state->integral + state->derivative;
  wanted = base + extra;
  /* The integral waits while the command is saturated and the error would drive it further. */
  if (!((wanted >= COMMAND_MAX && error > 0.0f) || (wanted <= 0.0f && error < 0.0f))) {
    state->integral = limit(state->integral + INTEGRAL_STEP * error, -COMMAND_MAX, COMMAND_MAX);
  }
  commands.base = limit(base, 0.0f, COMMAND_MAX);
  commands.command = limit(wanted, 0.0f, COMMAND_MAX);
  return commands;
}

static void begin_control(eupnea_state *state, float command) {
  state->integral = state->derivative = state->last_pressure = 0.0f;
  state->has_pressure = 0;
  fill_history(&state->errors, 0.0f);
  fill_history(&state->commands, command / COMMAND_SCALE);
  state->now = 0;
}

static output control(eupnea_state *state, const observation *seen) {
  float inputs[INPUTS];
  features(state, seen, inputs);
  recall(state, seen->tick, inputs + FEATURES);
  return pid(state, seen, limit(GAIN * network(inputs), -AUTHORITY, AUTHORITY));
}

static void applied(eupnea_state *state, float command) {
  const float error = state->errors.ring[state->now % HISTORY];
  push(&state->commands, state->now, command / COMMAND_SCALE, COMMAND_FACTORS);
  state->now++;
  record(state, error, command / COMMAND_SCALE);
}

/* --- Limits --- */

/* The learned part of the command changes by at most SLEW. */
static float slewed(eupnea_state *state, output commands) {
  const float learned = commands.command - commands.base;
  const float change = learned - state->learned;
  if (magnitude(change) <= SLEW) {
    state->learned = learned;
    return commands.command;
  }
  state->learned += limit(change, -SLEW, SLEW);
  return commands.base + state->learned;
}

static eupnea_command safe(float target) {
  eupnea_command command;
  command.u_in = 0.0f;
  command.u_out = 1;
  command.target = target;
  return command;
}

/* --- Interface --- */

void eupnea_init(eupnea_state *state) {
  const eupnea_settings none = {0};
  state->settings = none;
  state->rise_ticks = state->inspiration_ticks = state->fall_ticks = state->total_ticks = state->tick = 0;
  state->breathes = state->inspires = state->disturbed = state->cut = 0;
  state->last_command = state->learned = 0.0f;
  state->profiles[0].filled = 0;
  state->mean = state->adopted = 0;
  begin_profile(state);
  begin_control(state, 0.0f);
}

static int refusal(const eupnea_settings *settings) {
  if (!(@in_range@)) {
    return EUPNEA_OUT_OF_RANGE;
  }
  if (settings->pip < settings->peep + LEAST_RISE) {
    return EUPNEA_PIP_TOO_LOW;
  }
  if (settings->pressure_limit < settings->pip + LIMIT_MARGIN) {
    return EUPNEA_LIMIT_TOO_LOW;
  }
  if (settings->inspiratory_time + settings->fall_time > 60.0f / settings->rate) {
    return EUPNEA_BREATH_TOO_SHORT;
  }
  return EUPNEA_ACCEPTED;
}

/* Whether what was learned with the old settings helps with the new ones. */
static int outlasts(const eupnea_settings *old, const eupnea_settings *settings) {
  return @others_stay@ &&
         magnitude(settings->pip - old->pip) <= SMALL_STEP && magnitude(settings->peep - old->peep) <= SMALL_STEP;
}

int eupnea_start_breath(eupnea_state *state, const eupnea_settings *settings) {
  const int refused = refusal(settings);
  uint32_t least;
  if (refused != EUPNEA_ACCEPTED) {
    return refused;
  }
  if (state->inspires) {
    learn(state, DISCARD);
  }
  if (!state->breathes || !outlasts(&state->settings, settings)) {
    learn(state, FORGET);
  }
  state->settings = *settings;
  state->inspiration_ticks = ticks(settings->inspiratory_time);
  state->fall_ticks = ticks(settings->fall_time);
  state->total_ticks = ticks(60.0f / settings->rate);
  least = state->inspiration_ticks + state->fall_ticks;
  if (state->total_ticks < least) {
    state->total_ticks = least;
  }
  state->rise_ticks = ticks(settings->rise_time);
  if (state->rise_ticks > state->inspiration_ticks) {
    state->rise_ticks = state->inspiration_ticks;
  }
  state->tick = 0;
  state->breathes = state->inspires = 1;
  state->disturbed = state->cut = 0;
  begin_control(state, state->last_command);
  return EUPNEA_ACCEPTED;
}

eupnea_command eupnea_step(eupnea_state *state, float pressure) {
  const int sound = magnitude(pressure) <= HIGHEST_PRESSURE;
  enum phase phase = phase_of(state);
  float target;
  eupnea_command command;
  output commands;
  if (!state->breathes) {
    return safe(0.0f);
  }
  target = target_of(state, phase);
  if (phase == INSPIRATION) {
    state->cut = state->cut || (sound && pressure > state->settings.pressure_limit);
    if (state->cut) {
      phase = FALL;
      target = state->settings.peep;
    }
  }
  state->disturbed = state->disturbed || state->cut || !sound;
  if (state->inspires && phase != INSPIRATION) {
    learn(state, state->disturbed ? DISCARD : ADOPT);
    state->inspires = 0;
  }
  if (!sound) {
    command = safe(target);
    state->learned = 0.0f;
  } else {
    if (phase == INSPIRATION) {
      observation seen;
      seen.pressure = pressure;
      seen.target = target;
      seen.pip = state->settings.pip;
      seen.peep = state->settings.peep;
      seen.tick = state->tick;
      seen.rise_ticks = state->rise_ticks;
      commands = control(state, &seen);
    } else {
      commands.base = commands.command = phase == FALL ? 0.0f : state->settings.expiratory_bias;
    }
    command.u_in = limit(slewed(state, commands), 0.0f, COMMAND_MAX);
    command.u_out = phase != INSPIRATION;
    command.target = target;
    if (phase == INSPIRATION) {
      applied(state, command.u_in);
    }
  }
  state->last_command = command.u_in;
  /* It stays at its end: from 0 on it would inspire. */
  state->tick += state->tick < UINT32_MAX;
  return command;
}

int eupnea_is_due(const eupnea_state *state) { return state->tick >= state->total_ticks; }

void eupnea_disturb(eupnea_state *state) { state->disturbed = 1; }

/* --- Self-check --- */

/* Results of the trials: a breath, its lung, a tick with another reading, and the checksum of the commands. */
struct trial {
  eupnea_settings settings;
  float gain;
  uint32_t fault_tick, fault_reading, checksum;
};

@golden@
static uint32_t bits_of(float value) {
  union { float value; uint32_t bits; } both;
  both.value = value;
  return both.bits;
}

static float value_of(uint32_t bits) {
  union { float value; uint32_t bits; } both;
  both.bits = bits;
  return both.value;
}

/* CRC-32 as in zip, of a number of bytes of bits from the lowest on. */
static uint32_t checksum(uint32_t crc, uint32_t bits, uint32_t bytes) {
  uint32_t n;
  crc = ~crc;
  for (n = 0; n < 8 * bytes; n++) {
    const uint32_t low = (crc ^ (bits >> n)) & 1u;
    crc = (crc >> 1) ^ (low ? 0xEDB88320u : 0u);
  }
  return ~crc;
}

/* The test that the weights carry: a script of readings over two breaths. */
static int weights_differ(eupnea_state *state) {
  uint32_t breath, tick, bits = 0, crc = 0;
  eupnea_init(state);
  for (breath = 0; breath < LENGTH(SCRIPT_TICKS); breath++) {
    begin_control(state, SCRIPT_START);
    for (tick = 0; tick < SCRIPT_TICKS[breath]; tick++) {
      observation seen;
      float command;
      seen.pressure = SCRIPT_PRESSURES[tick];
      seen.target = rising(SCRIPT_PIP, SCRIPT_PEEP, SCRIPT_RISE_TICKS, tick);
      seen.pip = SCRIPT_PIP;
      seen.peep = SCRIPT_PEEP;
      seen.tick = tick;
      seen.rise_ticks = SCRIPT_RISE_TICKS;
      command = control(state, &seen).command;
      applied(state, command);
      bits = bits_of(command);
      crc = checksum(crc, bits, 4);
    }
    learn(state, ADOPT);
  }
  return bits != SCRIPT_LAST || crc != SCRIPT_ALL;
}

/* A breath on a simple lung: its pressure follows the command with a lag, and the reading has a ripple. */
static uint32_t breathe(eupnea_state *state, uint32_t number, float *pressure) {
  const struct trial *trial = &TRIALS[number];
  uint32_t crc = 0;
  if (eupnea_start_breath(state, &trial->settings) != EUPNEA_ACCEPTED) {
    return ~trial->checksum;
  }
  while (!eupnea_is_due(state)) {
    const uint32_t tick = state->tick;
    const float ripple = RIPPLE * (float)(RIPPLE_STEP * tick % RIPPLE_PERIOD);
    const float reading = tick == trial->fault_tick ? value_of(trial->fault_reading) : *pressure + ripple;
    const eupnea_command command = eupnea_step(state, reading);
    const float peep = trial->settings.peep;
    const float end = command.u_out ? peep : peep + trial->gain * command.u_in;
    *pressure += LUNG_STEP * (end - *pressure);
    crc = checksum(crc, bits_of(command.u_in), 4);
    crc = checksum(crc, (uint32_t)command.u_out, 1);
  }
  return crc;
}

int eupnea_self_check(eupnea_state *state) {
  int result = weights_differ(state);
  uint32_t number;
  float pressure = 0.0f;
  eupnea_init(state);
  for (number = 0; number < LENGTH(TRIALS) && result == 0; number++) {
    if (breathe(state, number, &pressure) != TRIALS[number].checksum) {
      result = 2 + (int)number;
    }
  }
  eupnea_init(state);
  return result;
}
