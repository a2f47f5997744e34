//! The supervision of a robot: `needleplan_guard::supervisor` with a clock and a wire, or with threads on a UDP socket.
//!
//! A robot that Python sends to by another wire is supervised by the same code, which Python then calls.

use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use needleplan_guard::datagram::{Kind, LONGEST, SessionLimits};
use needleplan_guard::hmac::{Key, Seal};
use needleplan_guard::session::{Message, Session};
use needleplan_guard::supervisor::{Post, Rules, Supervisor, Timed};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::guard::{Fields, known, never, state};
use crate::robot_threads::{Arrived, Clock, Core, IDLE, SENDING, Shared, Wire};

/// Ages of stage, loop, force, pose and deadman switch (s), infinite if not watched; shallowest and deepest depth (mm);
/// velocities inward and outward (mm/s); roll (rad).
type Limits = ([f64; 5], [f64; 2], [f64; 2], f64);
/// Times of the last and of the last usable sample, and whether it saw nothing.
type Times = (Option<i64>, Option<i64>, bool);
/// Number, causes and time of the last trip, and the causes that the age of the robot's samples gives.
type Seen = (u32, u64, i64, u64);

#[cfg(unix)]
fn socket_of(descriptor: i64) -> PyResult<UdpSocket> {
    use std::os::fd::{FromRawFd, OwnedFd, RawFd};
    let descriptor = RawFd::try_from(descriptor)?;
    // SAFETY: Python has detached the descriptor from its socket, so that nobody else has it.
    Ok(UdpSocket::from(unsafe { OwnedFd::from_raw_fd(descriptor) }))
}

#[cfg(windows)]
fn socket_of(descriptor: i64) -> PyResult<UdpSocket> {
    use std::os::windows::io::{FromRawSocket, OwnedSocket, RawSocket};
    let descriptor = RawSocket::try_from(descriptor)?;
    // SAFETY: as above.
    Ok(UdpSocket::from(unsafe { OwnedSocket::from_raw_socket(descriptor) }))
}

pub(crate) fn spawned(name: &str, work: impl FnOnce() + Send + 'static) -> PyResult<JoinHandle<()>> {
    let first = move || {
        precede();
        work();
    };
    thread::Builder::new().name(name.to_owned()).spawn(first).map_err(PyOSError::new_err)
}

/// Give this thread the next higher real-time priority, if it has one: the threads of Python have that of the program,
/// and one that is busy would delay another thread of the same priority.
#[cfg(target_os = "linux")]
fn precede() {
    // SAFETY: 0 is this thread, and `parameter` is a valid structure for both calls.
    unsafe {
        let (policy, mut parameter) = (libc::sched_getscheduler(0), std::mem::zeroed::<libc::sched_param>());
        if matches!(policy, libc::SCHED_FIFO | libc::SCHED_RR) && libc::sched_getparam(0, &raw mut parameter) == 0 {
            parameter.sched_priority = (parameter.sched_priority + 1).min(libc::sched_get_priority_max(policy));
            libc::sched_setscheduler(0, policy, &raw const parameter); // without permission, the priority stays
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn precede() {}

/// The supervision of one robot.
#[pyclass(module = "needleplan._ppvi", frozen)]
pub(crate) struct RobotSupervisor {
    shared: Arc<Shared>,
    wire: Mutex<Option<Arc<Wire>>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl RobotSupervisor {
    fn wire(&self) -> Option<Arc<Wire>> {
        self.wire.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[pymethods]
impl RobotSupervisor {
    #[new]
    fn new(now_ns: i64) -> Self {
        let session = Session::new(0, SessionLimits::default(), None, now_ns);
        let core = Core {
            supervisor: Supervisor::new(session, now_ns),
            arrived: VecDeque::new(),
            unread: 0,
            failure: None,
            is_closing: false,
            has_guard: false,
            alive_ns: now_ns,
            longest_gap_ns: 0,
        };
        let shared = Shared {
            core: Mutex::new(core),
            has_arrived: Condvar::new(),
            has_changed: Condvar::new(),
            unknown_senders: AtomicU64::new(0),
        };
        Self { shared: Arc::new(shared), wire: Mutex::default(), threads: Mutex::default() }
    }

    /// Take over a UDP socket: two threads receive from it and send what is due, until `close`.
    fn serve(&self, descriptor: i64, host: &str, port: u16, now_ns: i64) -> PyResult<()> {
        let clock = Clock { begin: Instant::now(), begin_ns: now_ns };
        let socket = socket_of(descriptor)?;
        socket.set_nonblocking(false)?;
        socket.set_read_timeout(Some(IDLE))?;
        socket.set_write_timeout(Some(SENDING))?;
        let host: IpAddr =
            host.parse().map_err(|_| PyValueError::new_err(format!("host = {host}: is not an address")))?;
        let wire = Arc::new(Wire { socket, peer: SocketAddr::new(host, port), clock });
        *self.wire.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&wire));
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        let (shared, its) = (Arc::clone(&self.shared), Arc::clone(&wire));
        threads.push(spawned("robot receive", move || shared.receive_on(&its))?);
        let shared = Arc::clone(&self.shared);
        threads.push(spawned("robot pace", move || shared.pace_on(&wire))?);
        Ok(())
    }

    /// End the threads, and close the socket.
    fn close(&self, py: Python<'_>) {
        self.shared.lock().is_closing = true;
        self.shared.has_changed.notify_all();
        self.shared.has_arrived.notify_all();
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        py.detach(|| {
            for thread in threads {
                let _ = thread.join();
            }
        });
        *self.wire.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Begin a session.
    fn begin(
        &self,
        session: u32,
        numbers: [f64; 5],
        silence_us: u32,
        valid_us: u32,
        key: Option<Vec<u8>>,
        now_ns: i64,
    ) {
        let seal = key.map(|key| Seal { key: Key::new(&key), nonce: 0 });
        let limits = SessionLimits { numbers, silence_us, valid_us };
        let mut core = self.shared.lock();
        core.supervisor.begin(Session::new(session, limits, seal, now_ns), now_ns);
        core.arrived.clear();
        core.has_guard = false;
    }

    /// Number of the next command.
    fn next_number(&self) -> u32 {
        self.shared.lock().supervisor.session.next_number()
    }

    /// Latest time on the clock of the robot of a command that must arrive within a time.
    fn deadline_ns(&self, within_ns: i64, now_ns: i64) -> u64 {
        self.shared.lock().supervisor.session.deadline_ns(within_ns, now_ns)
    }

    /// Send a datagram, or return it if there is no socket; None if the supervisor does not let it pass.
    fn send<'py>(
        &self,
        py: Python<'py>,
        kind: u8,
        number: u32,
        deadline_ns: u64,
        target: (f64, f64),
        now_ns: i64,
    ) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let kind = known(&Kind::ALL, kind.wrapping_sub(1))?;
        let wire = self.wire();
        let mut core = self.shared.lock();
        let mut bytes = [0; LONGEST];
        let size = core.supervisor.command(kind, number, deadline_ns, target, now_ns, &mut bytes);
        if size == 0 {
            return Ok(None);
        }
        let Some(wire) = wire else { return Ok(Some(PyBytes::new(py, &bytes[..size]))) };
        if kind == Kind::Alive {
            core.alive_ns = now_ns;
        }
        self.shared.send(&mut core, &wire, &bytes[..size]);
        Ok(Some(PyBytes::new(py, &[])))
    }

    /// Take a datagram of the robot that Python has received, and return what it means.
    fn take(&self, py: Python<'_>, datagram: &[u8], now_ns: i64) -> PyResult<Py<PyAny>> {
        let message = self.shared.lock().supervisor.take(datagram, now_ns);
        told(py, &(message, now_ns))
    }

    /// The datagrams that are to be sent now.
    fn due<'py>(&self, py: Python<'py>, now_ns: i64) -> Vec<Bound<'py, PyBytes>> {
        let (mut datagrams, mut bytes) = (Vec::new(), [0; LONGEST]);
        let mut core = self.shared.lock();
        loop {
            let size = core.supervisor.act(now_ns, &mut bytes);
            if size == 0 {
                return datagrams;
            }
            datagrams.push(PyBytes::new(py, &bytes[..size]));
        }
    }

    /// The next message that the threads have received; None after a time.
    fn receive(&self, py: Python<'_>, timeout_s: f64) -> PyResult<Option<Py<PyAny>>> {
        let end = Instant::now() + Duration::try_from_secs_f64(timeout_s.max(0.0)).unwrap_or(IDLE);
        let arrived = py.detach(|| {
            let mut core = self.shared.lock();
            loop {
                if let Some(arrived) = core.arrived.pop_front() {
                    return Ok(Some(arrived));
                }
                if let Some(failure) = &core.failure {
                    return Err(PyOSError::new_err(failure.clone()));
                }
                let left = end.saturating_duration_since(Instant::now());
                if left.is_zero() || core.is_closing {
                    return Ok(None);
                }
                core = self.shared.has_arrived.wait_timeout(core, left).unwrap_or_else(PoisonError::into_inner).0;
            }
        })?;
        arrived.map(|arrived| told(py, &arrived)).transpose()
    }

    /// Post the state of the guard and the times of its inputs.
    #[allow(clippy::too_many_arguments)]
    fn post(
        &self,
        limits: Limits,
        fields: Fields,
        trips: Option<u32>,
        force: Times,
        pose: Times,
        deadman_ns: Option<i64>,
        now_ns: i64,
    ) -> PyResult<()> {
        let ([stage_age_s, loop_age_s, force_age_s, pose_age_s, deadman_age_s], depths, velocities, roll_rad) = limits;
        let rules = Rules {
            stage_age_s,
            loop_age_s,
            force_age_s,
            pose_age_s,
            deadman_age_s,
            depth_mm: depths.into(),
            velocity_mm_s: velocities.into(),
            roll_rad,
        };
        let timed = |(taken_ns, usable_ns, is_unseen): Times| Timed {
            taken_ns: never(taken_ns),
            usable_ns: never(usable_ns),
            is_unseen,
        };
        let post = Post {
            state: state(fields)?,
            trips,
            force: timed(force),
            pose: timed(pose),
            deadman_ns: never(deadman_ns),
        };
        let mut core = self.shared.lock();
        core.supervisor.post(rules, post, now_ns);
        if !std::mem::replace(&mut core.has_guard, true) {
            self.shared.has_changed.notify_all();
        }
        Ok(())
    }

    /// Number, causes and time of the last trip, and the causes that the age of the robot's samples gives.
    fn seen(&self, stage_age_s: f64, now_ns: i64) -> Seen {
        let core = self.shared.lock();
        let trip = core.supervisor.trip();
        (trip.count, trip.causes.0, trip.time_ns, core.supervisor.of_stage(stage_age_s, now_ns).0)
    }

    /// Note that the loop runs.
    fn tick(&self, now_ns: i64) {
        self.shared.lock().supervisor.tick(now_ns);
    }

    /// Send no heartbeat until the next `tick`.
    fn withhold(&self) {
        self.shared.lock().supervisor.withhold();
    }

    /// Received, lost, repeated, unread, malformed, foreign and not authentic datagrams.
    #[getter]
    fn counts(&self) -> (u64, u64, u64, u64, u64, u64, u64) {
        let core = self.shared.lock();
        let counts = core.supervisor.session.counts;
        (
            counts.received,
            counts.lost,
            counts.repeated,
            core.unread,
            counts.malformed,
            counts.foreign,
            counts.not_authentic,
        )
    }

    #[getter]
    fn unknown_senders(&self) -> u64 {
        self.shared.unknown_senders.load(Ordering::Relaxed)
    }

    #[getter]
    fn version(&self) -> u8 {
        self.shared.lock().supervisor.session.version
    }

    #[getter]
    fn last_number(&self) -> u32 {
        self.shared.lock().supervisor.session.last_number()
    }

    #[getter]
    fn lost_control(&self) -> Option<u16> {
        self.shared.lock().supervisor.session.lost_control
    }

    #[getter]
    fn accepted(&self) -> Option<u32> {
        self.shared.lock().supervisor.session.accepted
    }

    #[getter]
    fn received_ns(&self) -> i64 {
        self.shared.lock().supervisor.session.received_ns
    }

    /// Last and longest round-trip time (ns).
    #[getter]
    fn round_trip_ns(&self) -> (Option<u64>, u64) {
        let clock = self.shared.lock().supervisor.session.clock;
        (clock.round_trip_ns, clock.worst_round_trip_ns)
    }

    /// Longest time between two heartbeats since the last call (ns).
    fn longest_gap_ns(&self) -> i64 {
        std::mem::take(&mut self.shared.lock().longest_gap_ns)
    }
}

impl Drop for RobotSupervisor {
    fn drop(&mut self) {
        self.shared.lock().is_closing = true;
        self.shared.has_changed.notify_all();
    }
}

/// A message as Python takes it: a status (0), an answer (1), another version (2), or nothing (3).
fn told(py: Python<'_>, (message, now_ns): &Arrived) -> PyResult<Py<PyAny>> {
    let tuple = match *message {
        Message::Status(status, lost) => {
            let head = status.head;
            let numbers =
                (head.session, head.sequence, head.sent_ns, head.echo_ns, head.held_us, head.number, head.version);
            let body = (
                status.depth_mm,
                status.velocity_mm_s,
                status.roll_rad,
                status.velocity_rad_s,
                status.faults,
                status.state,
                status.flags,
                status.overruns,
                status.missed,
            );
            (0, *now_ns, lost, numbers, body).into_pyobject(py)?
        }
        Message::Answer(answer) => (1, answer.head.number, answer.result).into_pyobject(py)?,
        Message::OtherVersion(version, kind) => (2, version, kind).into_pyobject(py)?,
        Message::Discarded => (3,).into_pyobject(py)?,
    };
    Ok(tuple.into_any().unbind())
}
