// Breath after breath under a learned controller, on any Arduino with 32 KB of flash, 8 KB of RAM and a double of 8 bytes.
// Research software: never on a patient. docs/C_EXPORT.md says which safeguards are missing.
//
// Write the controller into this folder first:
//   trainer export adult --out examples/arduino/pressure_controller/adult.c

#include "adult.h"

// Sensor MPXV7007DP, inspiratory valve by pulse width, expiratory valve open without current.
const int PRESSURE = A0, INSPIRATORY = 5, EXPIRATORY = 6;
// Converter counts and sensor voltages: full scale, zero, span; and the pressure at the end of the span, cmH2O.
const float COUNTS = 1023.0f, SUPPLY = 5.0f, ZERO = 2.5f, SPAN = 2.0f, SPAN_PRESSURE = 71.4f;

static adult_state state;
static adult_settings settings;

static float pressure() {
  const float volts = analogRead(PRESSURE) / COUNTS * SUPPLY;
  // Outside these voltages the wire is broken: not a number.
  return volts >= 0.25f && volts <= 4.75f ? (volts - ZERO) / SPAN * SPAN_PRESSURE : NAN;
}

static void apply(float u_in, bool u_out) {
  analogWrite(INSPIRATORY, (int)(u_in * 2.55f + 0.5f));
  digitalWrite(EXPIRATORY, u_out ? LOW : HIGH);
}

void setup() {
  pinMode(INSPIRATORY, OUTPUT);
  pinMode(EXPIRATORY, OUTPUT);
  apply(0.0f, true);
  Serial.begin(115200);
  const int difference = adult_self_check(&state);
  while (difference != 0) {
    Serial.println("this board computes other commands than the core: check the compiler's options");
    delay(1000);
  }
  settings.pip = 20.0f;
  settings.peep = 5.0f;
  settings.rate = 20.0f;
  settings.inspiratory_time = 1.0f;
  settings.rise_time = 0.1f;
  settings.fall_time = 0.5f;
  settings.expiratory_bias = 5.0f;
  settings.pressure_limit = 40.0f;
}

void loop() {
  static uint32_t next = micros();
  if ((int32_t)(micros() - next) < 0) {
    return;
  }
  next += ADULT_PERIOD_US;
  if (adult_is_due(&state) && adult_start_breath(&state, &settings) != ADULT_ACCEPTED) {
    Serial.println("the settings are refused");
  }
  const adult_command command = adult_step(&state, pressure());
  apply(command.u_in, command.u_out);
}
