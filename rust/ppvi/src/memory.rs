//! Large arrays on large pages.
//!
//! A solve of a few milliseconds would spend more time on the first touch of its memory, page by page, than on
//! arithmetic. Where the system offers transparent huge pages on request (Linux, `madvise`), these arrays ask for them;
//! elsewhere they are ordinary memory.

use std::alloc::{Layout, alloc, dealloc, handle_alloc_error};
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;

const HUGE_PAGE: usize = 2 << 20;

/// Asks for huge pages; a refusal changes nothing but speed.
#[cfg(target_os = "linux")]
fn advise(start: *mut u8, bytes: usize) {
    let first = (start as usize).next_multiple_of(HUGE_PAGE);
    let end = (start as usize + bytes) / HUGE_PAGE * HUGE_PAGE;
    if first < end {
        // SAFETY: the range lies inside an allocation of ours; the advice does not change its contents.
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_start: *mut u8, _bytes: usize) {}

/// `vec![value; len]` that asks for huge pages; for arrays that leave the crate.
pub(crate) fn filled<T: Copy>(value: T, len: usize) -> Vec<T> {
    let mut vec: Vec<T> = Vec::with_capacity(len);
    advise(vec.as_mut_ptr().cast(), len * size_of::<T>());
    vec.resize(len, value);
    vec
}

/// A fixed-size array, aligned to huge pages if it is that large.
#[derive(Debug)]
pub(crate) struct Array<T: Copy> {
    start: NonNull<T>,
    len: usize,
}

impl<T: Copy> Array<T> {
    pub(crate) fn filled(value: T, len: usize) -> Self {
        let layout = Self::layout(len);
        if layout.size() == 0 {
            return Array { start: NonNull::dangling(), len };
        }
        // SAFETY: the layout is not empty.
        let Some(start) = NonNull::new(unsafe { alloc(layout) }.cast::<T>()) else {
            handle_alloc_error(layout);
        };
        advise(start.as_ptr().cast(), layout.size());
        for index in 0..len {
            // SAFETY: index < len, and the allocation holds len elements.
            unsafe { start.add(index).write(value) };
        }
        Array { start, len }
    }

    fn layout(len: usize) -> Layout {
        let align = if len.saturating_mul(size_of::<T>()) >= HUGE_PAGE { HUGE_PAGE } else { 64 };
        match Layout::array::<T>(len).and_then(|layout| layout.align_to(align)) {
            Ok(layout) => layout,
            Err(_) => handle_alloc_error(Layout::new::<T>()),
        }
    }
}

impl<T: Copy> Default for Array<T> {
    fn default() -> Self {
        Array { start: NonNull::dangling(), len: 0 }
    }
}

impl<T: Copy> Drop for Array<T> {
    fn drop(&mut self) {
        let layout = Self::layout(self.len);
        if layout.size() > 0 {
            // SAFETY: allocated in `filled` with the same layout; elements are Copy and need no drop.
            unsafe { dealloc(self.start.as_ptr().cast(), layout) };
        }
    }
}

impl<T: Copy> Deref for Array<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: start points to len initialised elements, owned by self.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
    }
}

impl<T: Copy> DerefMut for Array<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above, and self is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.len) }
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
        assert!(Array::<f64>::default().is_empty());
    }
}
