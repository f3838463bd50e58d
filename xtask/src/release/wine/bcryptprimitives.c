/* The random numbers that Rust's standard library asks Windows for. Wine before version 9 does not have this library. */
unsigned char __stdcall SystemFunction036(void *buffer, unsigned long bytes);

__declspec(dllexport) int __stdcall ProcessPrng(unsigned char *buffer, unsigned long long bytes) {
  return SystemFunction036(buffer, (unsigned long)bytes);
}
