//! Instruction sets: one plain loop, compiled for each that a processor may have.
//!
//! Vector code here is plain code that the compiler vectorises; none of it depends on the order of
//! floating-point sums, so every instruction set gives the same bits. The only unsafe code of the
//! crate is in this module: a function compiled for an instruction set is called, which is sound
//! because an [`Isa`] can only be made of what the processor was found to have; and [`Strips`] reads
//! without bounds checks what was checked once before.
#![allow(unsafe_code)]

mod strips;

pub use strips::Strips;

use std::sync::LazyLock;

/// An instruction set that this processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Isa(Set);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    /// Whatever every processor of the architecture has; on `AArch64` that includes NEON.
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Default for Isa {
    /// The fastest that this processor has.
    fn default() -> Self {
        Self::best()
    }
}

impl Isa {
    /// What every processor has.
    pub const PLAIN: Self = Self(Set::Plain);

    /// Those that this processor has, the fastest last.
    #[must_use]
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self::PLAIN];
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx2") {
                all.push(Self(Set::Avx2));
            }
            if std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512bw")
                && std::arch::is_x86_feature_detected!("avx512vl")
            {
                all.push(Self(Set::Avx512));
            }
        }
        all
    }

    /// The fastest that this processor has.
    #[must_use]
    pub fn best() -> Self {
        static BEST: LazyLock<Isa> = LazyLock::new(|| Isa::available().last().copied().unwrap_or(Isa::PLAIN));
        *BEST
    }

    /// Runs a kernel compiled for this instruction set.
    pub(super) fn run<K: Kernel>(self, kernel: K) -> K::Out {
        match self.0 {
            Set::Plain => kernel.run(),
            // SAFETY: an `Isa` is only made of what the processor has.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => unsafe { avx2(kernel) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => unsafe { avx512(kernel) },
        }
    }
}

/// A loop worth compiling for every instruction set. `run`, and what it calls, must be
/// `#[inline(always)]`: only what is inlined is compiled anew.
pub(super) trait Kernel {
    /// What it computes.
    type Out;

    fn run(self) -> Self::Out;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<K: Kernel>(kernel: K) -> K::Out {
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512vl")]
fn avx512<K: Kernel>(kernel: K) -> K::Out {
    kernel.run()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Twice(u32);

    impl Kernel for Twice {
        type Out = u32;

        #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
        #[inline(always)]
        fn run(self) -> u32 {
            2 * self.0
        }
    }

    #[test]
    fn every_processor_has_the_plain_one_first() {
        let all = Isa::available();
        assert_eq!(all.first(), Some(&Isa::PLAIN));
        assert!(all.contains(&Isa::best()));
        for isa in all {
            assert_eq!(isa.run(Twice(21)), 42);
        }
    }
}
