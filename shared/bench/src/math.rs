//! The only file of the bench that names a mathematical function of f64.
//!
//! The square root is exact in IEEE 754; all others are those of libm by name, which consist of exact operations. So host and chip
//! agree in every bit.

pub(crate) use libm::{ceil, cos, exp, exp2, log as ln, round, sin};

/// Square root.
#[inline]
pub(crate) fn sqrt(x: f64) -> f64 {
    // One instruction where there is one; the result is the same.
    #[cfg(feature = "std")]
    return x.sqrt();
    #[cfg(not(feature = "std"))]
    libm::sqrt(x)
}
