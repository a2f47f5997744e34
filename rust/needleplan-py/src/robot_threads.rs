//! The threads that own the socket of a robot. They never take the interpreter: what Python posts and what it gets passes
//! through a lock that is held for microseconds.

use std::collections::VecDeque;
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use needleplan_guard::Nanoseconds;
use needleplan_guard::datagram::{Kind, LONGEST};
use needleplan_guard::session::Message;
use needleplan_guard::supervisor::Supervisor;

/// Largest number of messages that Python has not read; if more arrive, the oldest is discarded.
const KEPT: usize = 2000;
/// Time between two looks at the ages of what was posted, while there is a guard; else, and for closing, `IDLE`.
const PACE: Duration = Duration::from_micros(500);
pub(crate) const IDLE: Duration = Duration::from_millis(50);
/// Longest time for which a datagram is kept that the operating system has no room for.
pub(crate) const SENDING: Duration = Duration::from_millis(1);

/// A message, and the time of its arrival.
pub(crate) type Arrived = (Message, Nanoseconds);

/// Offset of the monotonic clock of Python from `Instant`, which is the same clock.
#[derive(Clone, Copy)]
pub(crate) struct Clock {
    pub(crate) begin: Instant,
    pub(crate) begin_ns: Nanoseconds,
}

impl Clock {
    fn now_ns(&self) -> Nanoseconds {
        self.begin_ns + self.begin.elapsed().as_nanos() as Nanoseconds
    }
}

pub(crate) struct Core {
    pub(crate) supervisor: Supervisor,
    pub(crate) arrived: VecDeque<Arrived>,
    pub(crate) unread: u64,
    pub(crate) failure: Option<String>,
    pub(crate) is_closing: bool,
    pub(crate) has_guard: bool,
    /// Time of the last datagram that was sent, and longest time between two heartbeats of one guard.
    pub(crate) alive_ns: Nanoseconds,
    pub(crate) longest_gap_ns: Nanoseconds,
}

pub(crate) struct Shared {
    pub(crate) core: Mutex<Core>,
    pub(crate) has_arrived: Condvar,
    pub(crate) has_changed: Condvar,
    pub(crate) unknown_senders: AtomicU64,
}

pub(crate) struct Wire {
    pub(crate) socket: UdpSocket,
    pub(crate) peer: SocketAddr,
    pub(crate) clock: Clock,
}

impl Shared {
    pub(crate) fn lock(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Send what is due. The caller holds the lock, so that datagrams leave in the order of their numbers.
    pub(crate) fn act(&self, core: &mut Core, wire: &Wire, now_ns: Nanoseconds) {
        let mut bytes = [0; LONGEST];
        loop {
            let size = core.supervisor.act(now_ns, &mut bytes);
            if size == 0 {
                return;
            }
            if bytes[5] == Kind::Alive as u8 {
                let gap_ns = now_ns - std::mem::replace(&mut core.alive_ns, now_ns);
                core.longest_gap_ns = core.longest_gap_ns.max(gap_ns);
            }
            self.send(core, wire, &bytes[..size]);
        }
    }

    pub(crate) fn send(&self, core: &mut Core, wire: &Wire, datagram: &[u8]) {
        if let Err(error) = wire.socket.send_to(datagram, wire.peer)
            && !is_full(&error)
        {
            core.failure = Some(error.to_string());
            self.has_arrived.notify_all();
        }
    }

    pub(crate) fn receive_on(&self, wire: &Wire) {
        let mut bytes = [0; 65_536];
        loop {
            let received = wire.socket.recv_from(&mut bytes);
            let now_ns = wire.clock.now_ns();
            let mut core = self.lock();
            if core.is_closing {
                return;
            }
            match received {
                Ok((size, sender)) if sender.ip() == wire.peer.ip() && sender.port() == wire.peer.port() => {
                    let message = core.supervisor.take(&bytes[..size], now_ns);
                    self.act(&mut core, wire, now_ns);
                    if message != Message::Discarded {
                        core.keep((message, now_ns));
                        self.has_arrived.notify_all();
                    }
                }
                Ok(_) => {
                    self.unknown_senders.fetch_add(1, Ordering::Relaxed);
                }
                Err(error) if is_full(&error) => {}
                Err(error) => {
                    core.failure = Some(error.to_string());
                    self.has_arrived.notify_all();
                    core = self.has_changed.wait_timeout(core, IDLE).unwrap_or_else(PoisonError::into_inner).0;
                    drop(core);
                }
            }
        }
    }

    pub(crate) fn pace_on(&self, wire: &Wire) {
        let mut core = self.lock();
        while !core.is_closing {
            self.act(&mut core, wire, wire.clock.now_ns());
            let wait = if core.has_guard { PACE } else { IDLE };
            core = self.has_changed.wait_timeout(core, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Core {
    fn keep(&mut self, arrived: Arrived) {
        self.arrived.push_back(arrived);
        if self.arrived.len() > KEPT
            && let Some((Message::Status(_, lost), _)) = self.arrived.pop_front()
        {
            self.unread += 1;
            let next = self.arrived.iter_mut().find_map(|(message, _)| match message {
                Message::Status(_, before) => Some(before),
                _ => None,
            });
            if let Some(before) = next {
                *before += lost + 1;
            }
        }
    }
}

/// Whether a call of the socket only had to wait.
pub(crate) fn is_full(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}
