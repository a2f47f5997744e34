//! A serial line to a robot: two threads carry datagrams between its frames and a UDP port of this machine.
//!
//! To the programs of this machine, the robot is then a robot at that port: the supervisor of a run, and a person's
//! `needleplan stop`. The threads never take the interpreter. Each sender at the port is one sender on the line.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use needleplan_guard::datagram::is_sound;
use needleplan_guard::line::{LONGEST_FRAME, LineQueue, Unframer};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::robot::spawned;
use crate::robot_threads::{IDLE, is_full};

/// Largest number of senders at a time. The one that has sent nothing for the longest time makes room for another one.
const SENDERS: usize = 16;
/// Longest time for which the driver of the line may have no room for a frame; then the frame is cut.
const ROOM: Duration = Duration::from_millis(2);
/// Bytes that are read at once.
const READ: usize = 512;
/// Errors of a port that is not there any more: EIO and ENXIO.
const GONE: [i32; 2] = [5, 6];

#[cfg(unix)]
mod port {
    use std::fs::File;
    use std::io;
    use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
    use std::time::Duration;

    use pyo3::PyResult;

    pub(super) fn of(descriptor: i64) -> PyResult<File> {
        let descriptor = RawFd::try_from(descriptor)?;
        // SAFETY: Python has duplicated the descriptor for this file, so that nobody else has it.
        Ok(File::from(unsafe { OwnedFd::from_raw_fd(descriptor) }))
    }

    /// Wait until a file can be read, or written; return whether it can, or has failed.
    pub(super) fn wait(file: &impl AsRawFd, to_write: bool, longest: Duration) -> io::Result<bool> {
        let events = if to_write { libc::POLLOUT } else { libc::POLLIN };
        let mut polled = libc::pollfd { fd: file.as_raw_fd(), events, revents: 0 };
        // SAFETY: `polled` is one valid pollfd, and the file is open.
        match unsafe { libc::poll(&mut polled, 1, longest.as_millis() as libc::c_int) } {
            -1 => Err(io::Error::last_os_error()),
            count => Ok(count > 0),
        }
    }
}

#[cfg(not(unix))]
mod port {
    use std::fs::File;
    use std::io;
    use std::time::Duration;

    use pyo3::PyResult;
    use pyo3::exceptions::PyOSError;

    pub(super) fn of(_: i64) -> PyResult<File> {
        Err(PyOSError::new_err("a robot on a serial line needs a POSIX system"))
    }

    pub(super) fn wait<T>(_: &T, _: bool, longest: Duration) -> io::Result<bool> {
        std::thread::sleep(longest);
        Ok(true)
    }
}

#[derive(Default)]
struct Senders {
    known: [Option<(SocketAddr, u64)>; SENDERS],
    heard: u64,
}

impl Senders {
    /// Number of a sender on the line, from 1.
    fn number(&mut self, address: SocketAddr) -> u8 {
        self.heard += 1;
        let is_it = |known: &Option<(SocketAddr, u64)>| known.is_some_and(|(other, _)| other == address);
        let place = self.known.iter().position(is_it).unwrap_or_else(|| {
            let age = |place: &usize| self.known[*place].map_or(0, |(_, heard)| heard);
            (0..SENDERS).min_by_key(age).unwrap_or(0)
        });
        self.known[place] = Some((address, self.heard));
        place as u8 + 1
    }

    fn address(&self, number: u8) -> Option<SocketAddr> {
        let place = usize::from(number).checked_sub(1)?;
        self.known.get(place).copied().flatten().map(|(address, _)| address)
    }
}

struct Line {
    socket: UdpSocket,
    senders: Mutex<Senders>,
    failure: Mutex<Option<String>>,
    is_closing: AtomicBool,
    /// Received bytes, received datagrams, and datagrams for which the line had no room.
    bytes: AtomicU64,
    datagrams: AtomicU64,
    dropped: AtomicU64,
}

impl Line {
    fn fail(&self, error: &io::Error) {
        let is_gone = error.raw_os_error().is_none_or(|number| GONE.contains(&number));
        let text = if is_gone { "the line was unplugged".into() } else { error.to_string() };
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
        self.is_closing.store(true, Ordering::Relaxed);
    }

    fn receive_on(&self, port: &File) {
        let (mut unframer, mut bytes, mut port) = (Unframer::default(), [0; READ], port);
        while !self.is_closing.load(Ordering::Relaxed) {
            let received =
                port::wait(port, false, IDLE).and_then(|is_ready| is_ready.then(|| port.read(&mut bytes)).transpose());
            match received {
                Ok(None) => (),
                Ok(Some(0)) => self.fail(&ErrorKind::UnexpectedEof.into()),
                Ok(Some(size)) => self.take(&mut unframer, &bytes[..size]),
                Err(error) if is_full(&error) => (),
                Err(error) => self.fail(&error),
            }
        }
    }

    fn take(&self, unframer: &mut Unframer, bytes: &[u8]) {
        self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        for byte in bytes {
            let Some((sender, datagram)) = unframer.push(*byte) else { continue };
            if is_sound(datagram) {
                self.datagrams.fetch_add(1, Ordering::Relaxed);
                let address = self.senders.lock().unwrap_or_else(PoisonError::into_inner).address(sender);
                if let Some(address) = address {
                    let _ = self.socket.send_to(datagram, address); // lost, if the program is gone or has no room
                }
            }
        }
    }

    fn send_on(&self, port: &File, mut queue: LineQueue) {
        let (begin, mut frame, mut datagram) = (Instant::now(), [0; LONGEST_FRAME], [0; 65_536]);
        while !self.is_closing.load(Ordering::Relaxed) {
            while let Ok((size, address)) = self.socket.recv_from(&mut datagram) {
                let sender = self.senders.lock().unwrap_or_else(PoisonError::into_inner).number(address);
                queue.put(sender, &datagram[..size]);
            }
            self.dropped.store(queue.dropped, Ordering::Relaxed);
            let now_ns = begin.elapsed().as_nanos() as i64;
            let size = queue.take(now_ns, &mut frame);
            if size > 0 {
                self.write(port, &frame[..size]);
            } else if let Some(wait_ns) = queue.wait_ns(now_ns) {
                // Until the line is free, not even a STOP can leave.
                thread::sleep(Duration::from_nanos(wait_ns as u64));
            } else if let Err(error) = port::wait(&self.socket, false, IDLE)
                && !is_full(&error)
            {
                self.fail(&error);
            }
        }
    }

    /// Write a frame. If the driver takes only a part of it, the frame is cut, and the robot drops it.
    fn write(&self, mut port: &File, mut frame: &[u8]) {
        while !frame.is_empty() {
            match port.write(frame) {
                Ok(size) => frame = &frame[size..],
                Err(error) if error.kind() == ErrorKind::Interrupted => (),
                Err(error) if is_full(&error) => match port::wait(port, true, ROOM) {
                    Ok(true) => (),
                    _ => return,
                },
                Err(error) => return self.fail(&error),
            }
        }
    }
}

/// A serial line to a robot, and the UDP port of this machine behind which the robot is.
#[pyclass(module = "needleplan._ppvi", frozen)]
pub(crate) struct RobotLine {
    line: Arc<Line>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    #[pyo3(get)]
    port: u16,
}

#[pymethods]
impl RobotLine {
    /// Take over the descriptor of a serial port, which does not block.
    #[new]
    fn new(descriptor: i64, baud: u32) -> PyResult<Self> {
        let port = port::of(descriptor)?;
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).map_err(PyOSError::new_err)?;
        socket.set_nonblocking(true)?;
        let number = socket.local_addr()?.port();
        let line = Arc::new(Line {
            socket,
            senders: Mutex::default(),
            failure: Mutex::default(),
            is_closing: AtomicBool::new(false),
            bytes: AtomicU64::new(0),
            datagrams: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        });
        let (receiving, sending, other) = (Arc::clone(&line), Arc::clone(&line), port.try_clone()?);
        // The threads alone have the port, so that it is free for another program when they end.
        let threads = vec![
            spawned("line receive", move || receiving.receive_on(&port))?,
            spawned("line send", move || sending.send_on(&other, LineQueue::new(baud)))?,
        ];
        Ok(Self { line, threads: Mutex::new(threads), port: number })
    }

    /// Why the line carries nothing any more; None while it does.
    #[getter]
    fn failure(&self) -> Option<String> {
        self.line.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Received bytes, received datagrams, and datagrams for which the line had no room.
    #[getter]
    fn counts(&self) -> (u64, u64, u64) {
        let line = &self.line;
        let [bytes, datagrams, dropped] =
            [&line.bytes, &line.datagrams, &line.dropped].map(|count| count.load(Ordering::Relaxed));
        (bytes, datagrams, dropped)
    }

    /// End the threads.
    fn close(&self, py: Python<'_>) {
        self.line.is_closing.store(true, Ordering::Relaxed);
        let threads = std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        py.detach(|| {
            for thread in threads {
                let _ = thread.join();
            }
        });
    }
}

impl Drop for RobotLine {
    fn drop(&mut self) {
        self.line.is_closing.store(true, Ordering::Relaxed);
    }
}
