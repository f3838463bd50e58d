// What the sketch uses of Arduino's library, to compile it without one.
#include <math.h>
#include <stdint.h>

enum { A0 = 14, INPUT = 0, OUTPUT = 1, LOW = 0, HIGH = 1 };
int analogRead(uint8_t pin);
void analogWrite(uint8_t pin, int value);
void digitalWrite(uint8_t pin, uint8_t value);
void pinMode(uint8_t pin, uint8_t mode);
void delay(unsigned long milliseconds);
unsigned long micros();
struct Print {
  void begin(unsigned long baud);
  void println(const char *text);
};
extern Print Serial;
