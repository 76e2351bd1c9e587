//! What the kernels calculate with: single and double precision, as vectors of whatever width the machine has.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use pulp::Simd;

use crate::grid::GridValues;

/// A number of the kernels, alone and as a vector.
pub trait Real: Copy + PartialOrd + Send + Sync + Default + std::fmt::Debug + 'static {
    /// A vector of the instruction set `S`.
    type Vector<S: Simd>: Copy;
    /// Numbers in a vector.
    fn lanes<S: Simd>() -> usize;
    /// Distance from one to the next number of this precision.
    fn epsilon() -> f64;
    /// Rounded to this precision.
    fn from_f64(value: f64) -> Self;
    /// In double precision.
    fn to_f64(self) -> f64;
    /// The values of a map in this precision; nothing of one that is kept in the other.
    fn of(values: &GridValues) -> &[Self];
    /// `a + share (b - a)`.
    fn mix(a: Self, b: Self, share: Self) -> Self;
    /// Whole vectors of a slice, and the rest.
    fn vectors<S: Simd>(slice: &[Self]) -> (&[Self::Vector<S>], &[Self]);
    /// Whole vectors of a slice, to write to.
    fn vectors_mut<S: Simd>(slice: &mut [Self]) -> &mut [Self::Vector<S>];
    /// The beginning of a vector from fewer numbers than it holds.
    fn load<S: Simd>(simd: S, slice: &[Self]) -> Self::Vector<S>;
    /// The same number in every lane.
    fn splat<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;
    /// `a b + c`, in one rounding where the machine has it.
    fn fma<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>, c: Self::Vector<S>) -> Self::Vector<S>;
    /// `a + b`.
    fn add<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// `a - b`.
    fn sub<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// `a b`.
    fn mul<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// Absolute value.
    fn abs<S: Simd>(simd: S, a: Self::Vector<S>) -> Self::Vector<S>;
    /// The vector that begins one lane later; `after` is the one that follows.
    fn one_later<S: Simd>(simd: S, here: Self::Vector<S>, after: Self::Vector<S>) -> Self::Vector<S>;
    /// `yes` in the lanes where `m` is a number, `no` where it is NaN: a missing map value is NaN.
    fn if_known<S: Simd>(simd: S, m: Self::Vector<S>, yes: Self::Vector<S>, no: Self::Vector<S>) -> Self::Vector<S>;
}

macro_rules! real {
    ($t:ty, $kind:ident, $v:ident, $lanes:ident, $as:ident, $as_mut:ident, $load:ident, $splat:ident, $fma:ident, $add:ident,
     $sub:ident, $mul:ident, $abs:ident, $equal:ident, $select:ident, $rotate:ident, $between:ident) => {
        impl Real for $t {
            type Vector<S: Simd> = S::$v;
            #[inline(always)]
            fn lanes<S: Simd>() -> usize {
                S::$lanes
            }
            #[inline(always)]
            fn epsilon() -> f64 {
                Self::EPSILON.to_f64()
            }
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            fn of(values: &GridValues) -> &[Self] {
                match values {
                    GridValues::$kind(values) => values,
                    _ => &[],
                }
            }
            #[inline(always)]
            fn mix(a: Self, b: Self, share: Self) -> Self {
                a + share * (b - a)
            }
            #[inline(always)]
            fn vectors<S: Simd>(slice: &[Self]) -> (&[S::$v], &[Self]) {
                S::$as(slice)
            }
            #[inline(always)]
            fn vectors_mut<S: Simd>(slice: &mut [Self]) -> &mut [S::$v] {
                S::$as_mut(slice).0
            }
            #[inline(always)]
            fn load<S: Simd>(simd: S, slice: &[Self]) -> S::$v {
                simd.$load(slice)
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, value: Self) -> S::$v {
                simd.$splat(value)
            }
            #[inline(always)]
            fn fma<S: Simd>(simd: S, a: S::$v, b: S::$v, c: S::$v) -> S::$v {
                simd.$fma(a, b, c)
            }
            #[inline(always)]
            fn add<S: Simd>(simd: S, a: S::$v, b: S::$v) -> S::$v {
                simd.$add(a, b)
            }
            #[inline(always)]
            fn sub<S: Simd>(simd: S, a: S::$v, b: S::$v) -> S::$v {
                simd.$sub(a, b)
            }
            #[inline(always)]
            fn mul<S: Simd>(simd: S, a: S::$v, b: S::$v) -> S::$v {
                simd.$mul(a, b)
            }
            #[inline(always)]
            fn abs<S: Simd>(simd: S, a: S::$v) -> S::$v {
                simd.$abs(a)
            }
            #[inline(always)]
            fn one_later<S: Simd>(simd: S, here: S::$v, after: S::$v) -> S::$v {
                let all_but_last = simd.$between(0, (S::$lanes - 1) as _).mask();
                simd.$select(all_but_last, simd.$rotate(here, 1), simd.$rotate(after, 1))
            }
            #[inline(always)]
            fn if_known<S: Simd>(simd: S, m: S::$v, yes: S::$v, no: S::$v) -> S::$v {
                simd.$select(simd.$equal(m, m), yes, no)
            }
        }
    };
}
real!(
    f32,
    F32,
    f32s,
    F32_LANES,
    as_simd_f32s,
    as_mut_simd_f32s,
    partial_load_f32s,
    splat_f32s,
    mul_add_e_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    abs_f32s,
    equal_f32s,
    select_f32s,
    rotate_left_f32s,
    mask_between_m32s
);
real!(
    f64,
    F64,
    f64s,
    F64_LANES,
    as_simd_f64s,
    as_mut_simd_f64s,
    partial_load_f64s,
    splat_f64s,
    mul_add_e_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    abs_f64s,
    equal_f64s,
    select_f64s,
    rotate_left_f64s,
    mask_between_m64s
);

/// Runs a kernel with the best instruction set of this machine, chosen at run time.
///
/// The kernel's `call` must be inlined (`#[inline(always)]`) to be compiled for that set. `FUSED` tells it whether
/// fused multiply-add is an instruction there.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    match crate::instructions::chosen() {
        pulp::Arch::Scalar => kernel.call::<false>(),
        arch => arch.dispatch(Fused(kernel)),
    }
}

/// A computation that is compiled once for each instruction set.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// The computation.
    fn call<const FUSED: bool>(self) -> Self::Output;
}

struct Fused<K>(K);

impl<K: Kernel> pulp::WithSimd for Fused<K> {
    type Output = K::Output;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> K::Output {
        self.0.call::<true>()
    }
}
