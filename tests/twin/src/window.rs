//! A chip in a window of the part's addresses, as a model of a slot of its own.

use rigless::chip::parallel::Peer;
use rigless::device::{DeviceContext as Context, ErasedDevice, RegisterFile, RequestChange};
use rigless::soc::{RegisterSpec, Width};
use rigless::time::{EventId, VirtualNanos};

/// The emulator's own such type is private to it. Its check of the wiring wants the very table that the bus gave the
/// window, which has no registers.
#[derive(Debug)]
pub struct Windowed<P> {
    pub chip: P,
    pub table: &'static [RegisterSpec],
}

impl<P: Peer> ErasedDevice for Windowed<P> {
    fn layout(&self) -> &'static [RegisterSpec] {
        self.table
    }

    fn read(&mut self, _: usize, _: &mut RegisterFile, _: &mut Context<'_>) -> Option<u64> {
        None
    }

    fn write(&mut self, _: usize, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}

    fn on_event(&mut self, event: EventId, _: &mut RegisterFile, context: &mut Context<'_>) {
        self.chip.on_event(event, context);
    }

    fn on_request(&mut self, _: RequestChange, _: &mut RegisterFile, _: &mut Context<'_>) {}

    fn on_clock(&mut self, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}

    fn poll(&mut self, _: &mut RegisterFile, context: &mut Context<'_>) {
        self.chip.poll(context);
    }

    fn reset(&mut self) {
        self.chip.reset();
    }

    fn on_access(&mut self, _: u64, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}

    fn on_refused(&mut self, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}

    fn read_window(&mut self, offset: u64, width: Width, context: &mut Context<'_>) -> u64 {
        self.chip.read(offset, width, context)
    }

    fn write_window(&mut self, offset: u64, width: Width, value: u64, context: &mut Context<'_>) {
        self.chip.write(offset, width, value, context);
    }

    fn peek_window(&self, offset: u64, width: Width, now: VirtualNanos) -> Option<u64> {
        self.chip.peek(offset, width, now)
    }
}
