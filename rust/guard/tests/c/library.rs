//! The guard as a library without `std` for programs in C: what a microcontroller would link.
#![no_std]

extern crate needleplan_guard;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
