//! A board's service task without a board: the node between a link and a flash in RAM, until it is to start
//! anew. What stands here is what a board's task has to do, in the same order.

use embassy_futures::block_on;
use sha2::{Digest, Sha256};
use slipsense::node::{Action, FileSink, Identity, Node, Severity, UpdateTarget, Version};
use slipsense::settings::{SCRATCH, SettingsStore};
use slipsense::wire::CanFrame;

use crate::ram_flash::{FLASH_BYTES, RamFlash};

/// Bytes of the largest file that is taken.
pub const FILE_MAX: u32 = 512 * 1024;
/// Bytes of the SHA-256 that ends every file.
const HASH_BYTES: usize = 32;

/// Bytes in, bytes out, and the time. None of them waits.
pub trait Link {
    /// The next frame that has arrived, and when, µs since start.
    fn receive(&mut self) -> Option<(CanFrame, u64)>;
    /// Send a frame.
    fn send(&mut self, frame: &CanFrame);
    /// µs since start.
    fn now_us(&self) -> u64;
    /// Nothing to do for a moment.
    fn idle(&mut self);
}

/// Checks that a file ends in the SHA-256 of everything before, without room for the file.
struct HashSink {
    hash: Sha256,
    /// The last bytes, which may be the hash.
    tail: heapless::Deque<u8, HASH_BYTES>,
}

impl HashSink {
    fn new() -> Self {
        Self { hash: Sha256::new(), tail: heapless::Deque::new() }
    }
}

impl FileSink for HashSink {
    async fn write(&mut self, _: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), &'static str> {
        if offset == 0 {
            *self = Self::new();
        }
        for &byte in bytes {
            if self.tail.is_full() {
                let before = self.tail.pop_front().ok_or("no room")?;
                self.hash.update([before]);
            }
            self.tail.push_back(byte).map_err(|_| "no room")?;
        }
        Ok(())
    }

    async fn finish(&mut self, _: UpdateTarget, length: u32) -> Result<(), &'static str> {
        if length < HASH_BYTES as u32 {
            return Err("shorter than its hash");
        }
        let hash = core::mem::take(&mut self.hash).finalize();
        if hash.iter().eq(self.tail.iter()) { Ok(()) } else { Err("hash wrong") }
    }
}

/// Serve until the node is to start anew. `unique_id` tells the boards apart.
pub fn serve(link: &mut impl Link, flash: &mut [u8; FLASH_BYTES], unique_id: [u8; 16]) {
    let mut scratch = SCRATCH;
    let mut store =
        SettingsStore::new(RamFlash(flash), 0..FLASH_BYTES as u32, &mut scratch).expect("two whole sectors");
    let (settings, report) = block_on(store.load());
    let identity = Identity {
        hardware_version: Version { major: 0, minor: 1 },
        software_version: Version::SOFTWARE,
        vcs_revision: 0xC0FF_EE00_1234_5678,
        unique_id,
        model_hash: Some(Sha256::digest(b"no model").into()),
        settings: report,
        entropy: None,
    };
    let mut node = Node::new(identity, settings);
    node.set_operational();
    let mut sink = HashSink::new();
    let mut restart = false;
    loop {
        let mut busy = false;
        while let Some((frame, at_us)) = link.receive() {
            node.accept(&frame, at_us);
            busy = true;
        }
        node.status.sensors = node.settings().sensors();
        node.poll(link.now_us());
        while let Some(action) = node.take_action() {
            match action {
                Action::Restart => restart = true,
                Action::Store | Action::FactoryReset => {
                    let result = block_on(store.store(node.settings()));
                    match &result {
                        Ok(()) => node.command_done(Ok(())),
                        Err(_) => node.command_done(Err("the flash refused a write")),
                    }
                }
                Action::Calibrate(_) => node.command_done(Err("there is no array")),
                Action::SelfTest => {
                    node.status.self_tests += 1;
                    node.command_done(Ok(()));
                }
                Action::BeginUpdate { target, file } => node.begin_download(target, file, FILE_MAX),
                // This board has no key: nothing unlocks it.
                Action::Unlock(_) => node.unlock_done(false),
                Action::Identify | Action::UpdateReceived { .. } | Action::UpdateFailed { .. } => {}
            }
        }
        while let Some(setting) = node.take_changed() {
            node.report(Severity::Debug, format_args!("{} changed", setting.definition().name));
        }
        if let Some(chunk) = node.take_chunk() {
            let result = block_on(chunk.deliver(&mut sink));
            node.chunk_done(&chunk, result);
            node.poll(link.now_us());
            busy = true;
        }
        while let Some(frame) = node.next_frame() {
            link.send(&frame);
        }
        if restart {
            return;
        }
        if !busy {
            link.idle();
        }
    }
}
