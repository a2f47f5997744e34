//! Large arrays on huge pages, with memory that is reused by the next solve.
//!
//! A solve may take only a few milliseconds. The system's work for the first access to each page of new memory would
//! then take longer than the arithmetic. On Linux these arrays request transparent huge pages (`madvise`); on other
//! systems they are ordinary memory. The memory of dropped arrays is kept for the next solve.

use std::alloc::{Layout, alloc, dealloc, handle_alloc_error};
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;
use std::sync::{Mutex, MutexGuard};

/// Size of a huge page, bytes.
const HUGE_PAGE: usize = 2 << 20;

/// Requests huge pages for a range of memory. If the system refuses, only speed is lost.
#[cfg(target_os = "linux")]
fn advise(start: *mut u8, bytes: usize) {
    let first = (start as usize).next_multiple_of(HUGE_PAGE);
    let end = (start as usize + bytes) / HUGE_PAGE * HUGE_PAGE;
    if first < end {
        // SAFETY: the range lies inside an allocation of the caller, and the advice does not change its contents.
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_start: *mut u8, _bytes: usize) {}

/// `vec![value; len]` on huge pages, for arrays that are returned to the caller of the crate.
///
/// For zeros `vec!` takes memory that the system has cleared already.
pub(crate) fn filled<T: Copy>(value: T, len: usize) -> Vec<T> {
    let mut vec = vec![value; len];
    advise(vec.as_mut_ptr().cast(), len * size_of::<T>());
    vec
}

/// An empty vector with capacity `len` on huge pages, for arrays that are returned to the caller of the crate.
pub(crate) fn reserved<T: Copy>(len: usize) -> Vec<T> {
    let mut vec: Vec<T> = Vec::with_capacity(len);
    advise(vec.as_mut_ptr().cast(), len * size_of::<T>());
    vec
}

/// Whether the system grants this much memory, bytes, in one piece. It is returned at once, and a system that grants
/// more than it has may still fail later. But a size by mistake, such as 2^38 states, is found before it ends the
/// program.
pub(crate) fn is_granted(bytes: u128) -> bool {
    let mut probe: Vec<u8> = Vec::new();
    let granted = usize::try_from(bytes).is_ok_and(|bytes| probe.try_reserve_exact(bytes).is_ok());
    // The compiler may leave out an allocation that nobody looks at.
    std::hint::black_box(probe.as_ptr());
    granted
}

/// Largest total size, bytes, of the kept memory of dropped arrays. A solver that is called repeatedly then does not
/// wait for the system to clear pages.
const KEPT_BYTES: usize = 64 << 20;

/// The kept memory of dropped arrays.
static KEPT: Mutex<Vec<Block>> = Mutex::new(Vec::new());

/// Attempts to lock [`KEPT`] before the kept memory is left alone. It is held for less than a microsecond; if it stays
/// locked, a fork has copied it in this state, and the thread that would unlock it does not exist in this process.
const LOCK_ATTEMPTS: usize = 1000;

fn lock_kept() -> Option<MutexGuard<'static, Vec<Block>>> {
    (0..LOCK_ATTEMPTS).find_map(|_| KEPT.try_lock().inspect_err(|_| std::thread::yield_now()).ok())
}

/// A block of allocated memory.
struct Block {
    start: NonNull<u8>,
    layout: Layout,
}

// SAFETY: a block owns its memory, and no references to it exist.
unsafe impl Send for Block {}

impl Block {
    /// Returns a block of at least `bytes`, and whether it is new and so not initialised. Takes the smallest kept block
    /// that is at most a quarter larger, otherwise new memory.
    fn take(bytes: usize) -> (Self, bool) {
        let align = if bytes >= HUGE_PAGE { HUGE_PAGE } else { 64 };
        let Ok(layout) = Layout::from_size_align(bytes, align) else { handle_alloc_error(Layout::new::<u8>()) };
        if let Some(mut kept) = lock_kept() {
            let fits = |block: &Block| (bytes..=bytes + bytes / 4).contains(&block.layout.size());
            let best = (0..kept.len()).filter(|at| fits(&kept[*at])).min_by_key(|at| kept[*at].layout.size());
            if let Some(at) = best {
                return (kept.swap_remove(at), false);
            }
        }
        // SAFETY: the layout is not empty.
        let Some(start) = NonNull::new(unsafe { alloc(layout) }) else { handle_alloc_error(layout) };
        advise(start.as_ptr(), bytes);
        (Block { start, layout }, true)
    }

    /// Keeps the memory if [`KEPT_BYTES`] allows it, otherwise frees it.
    fn leave(self) {
        if let Some(mut kept) = lock_kept() {
            let bytes: usize = kept.iter().map(|block| block.layout.size()).sum();
            if bytes + self.layout.size() <= KEPT_BYTES {
                kept.push(self);
                return;
            }
        }
        // SAFETY: allocated in `take` with this layout, and no reference to it is left.
        unsafe { dealloc(self.start.as_ptr(), self.layout) };
    }
}

/// An array of fixed length, aligned to huge pages if it is at least as large as one.
pub(crate) struct Array<T: Copy> {
    /// None if the array is empty.
    block: Option<Block>,
    len: usize,
    element: PhantomData<T>,
}

/// Numbers without invalid bit patterns.
///
/// # Safety
///
/// Every bit pattern must be a value of the type.
pub(crate) unsafe trait Plain: Copy + Default {}
// SAFETY: every bit pattern is an integer.
unsafe impl Plain for u8 {}
// SAFETY: every bit pattern is a number or NaN.
unsafe impl Plain for f32 {}
// SAFETY: as above.
unsafe impl Plain for f64 {}

impl<T: Plain> Array<T> {
    /// An array with arbitrary contents; write before reading.
    pub(crate) fn any(len: usize) -> Self {
        Self::make(len, T::default(), false)
    }
}

impl<T: Copy> Array<T> {
    pub(crate) fn filled(value: T, len: usize) -> Self {
        Self::make(len, value, true)
    }

    /// Writes `value` to all elements if `filled` is set, or if the memory is new and therefore uninitialised.
    fn make(len: usize, value: T, filled: bool) -> Self {
        let Ok(layout) = Layout::array::<T>(len) else { handle_alloc_error(Layout::new::<T>()) };
        if layout.size() == 0 {
            return Array { block: None, len, element: PhantomData };
        }
        let (block, new) = Block::take(layout.size());
        if filled || new {
            let start = block.start.cast::<T>();
            for index in 0..len {
                // SAFETY: index < len, and the block holds len elements.
                unsafe { start.add(index).write(value) };
            }
        }
        Array { block: Some(block), len, element: PhantomData }
    }

    fn start(&self) -> NonNull<T> {
        self.block.as_ref().map_or(NonNull::dangling(), |block| block.start.cast())
    }
}

impl<T: Copy> Drop for Array<T> {
    fn drop(&mut self) {
        // Elements are Copy and need no drop.
        self.block.take().into_iter().for_each(Block::leave);
    }
}

impl<T: Copy> Deref for Array<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: start points to len initialised elements that self owns.
        unsafe { std::slice::from_raw_parts(self.start().as_ptr(), self.len) }
    }
}

impl<T: Copy> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above, and self is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(self.start().as_ptr(), self.len) }
    }
}

// SAFETY: an Array owns its elements like a Vec.
unsafe impl<T: Copy + Send> Send for Array<T> {}
// SAFETY: shared references give shared access to the elements only.
unsafe impl<T: Copy + Sync> Sync for Array<T> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_by_mistake_is_not_granted() {
        assert!(is_granted(1000) && !is_granted(1 << 60) && !is_granted(1 << 70));
    }

    #[test]
    fn arrays_hold_what_was_written() {
        for len in [0, 1, 1000, 3 << 20] {
            let mut array = Array::filled(7f32, len);
            assert!(array.len() == len && array.iter().all(|x| *x == 7.0));
            assert!(Array::filled(0f64, len).iter().all(|x| *x == 0.0));
            if let Some(last) = array.last_mut() {
                *last = 9.0;
                assert_eq!(array[len - 1], 9.0);
            }
            assert_eq!(filled(3u8, len), vec![3u8; len]);
        }
        assert!(Array::filled(1f64, 0).is_empty());
    }
}
