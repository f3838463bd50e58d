/* Start of a Cortex-M4F: the vector table, and the floating-point unit, which is off after a reset. */
#include <stdint.h>

extern uint32_t stack_top;
extern void _start(void);

void reset(void) {
  *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20;
  __asm volatile("dsb\n isb");
  _start();
}

__attribute__((section(".vectors"), used)) static const void *const VECTORS[] = {&stack_top, (const void *)reset};
