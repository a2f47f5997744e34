% Control side of the needleplan robot protocol (robot-protocol.md), in version 2. Not tested.
% Requests control, enables, inserts 20 mm at 5 mm/s, and shows the depth.
u = udpport("datagram", "IPV4"); robot = "192.168.1.10"; port = 5005;
session = uint32(randi([1, 2^31])); sequence = uint32(0); last = uint64(0); lastAt = tic; start = tic;

function bytes = command(kind, session, sequence, number, sent, deadline, target, speed)
    if kind == 1                                                 % HELLO: 0 to 30 mm, 8 mm/s, 7 rad, 6 rad/s, 0.1 s
        size = 96; content = [typecast(double([0, 30, 8, 7, 6]), 'uint8'), ...
            typecast(uint32([30000, 100000, 0]), 'uint8')];
    else
        size = 72; content = [typecast(uint64(deadline), 'uint8'), ...
            typecast(double([target, speed]), 'uint8'), typecast(uint32(30000), 'uint8')];
    end
    body = [uint8('NPLR'), uint8([2, kind]), typecast(uint16(size), 'uint8'), ...
        typecast(uint32([session, sequence]), 'uint8'), typecast(uint64([sent, 0]), 'uint8'), ...
        typecast(uint32([0, number]), 'uint8'), content];
    crc = java.util.zip.CRC32; crc.update(body);
    bytes = [body, typecast(uint32(crc.getValue), 'uint8')];
end

% HELLO 1, RESET 7, ENABLE 2, INSERT 3; then ALIVE 6 every 7 ms. Each command is repeated until it is answered.
plan = {1, 0, 0; 7, 0, 0; 2, 0, 0; 3, 20, 5}; number = 1; answered = false;
while toc(start) < 10
    sequence = sequence + 1; sent = uint64(toc(start) * 1e9) + 1;
    deadline = last + uint64(toc(lastAt) * 1e9) + 30e6;          % on the clock of the robot
    if number <= 4
        write(u, command(plan{number, 1}, session, sequence, number, sent, deadline, plan{number, 2:3}), "uint8", robot, port);
    else
        write(u, command(6, session, sequence, 0, sent, deadline, 0, 0), "uint8", robot, port);
    end
    pause(0.007);
    while u.NumDatagramsAvailable > 0
        data = uint8(read(u, 1, "uint8").Data);
        crc = java.util.zip.CRC32; crc.update(data(1:end-4));
        if numel(data) < 56 || typecast(data(end-3:end), 'uint32') ~= crc.getValue, continue, end
        last = typecast(data(17:24), 'uint64'); lastAt = tic;
        about = typecast(data(37:40), 'uint32');
        if data(6) == 129 && about == number                     % ANSWER
            assert(typecast(data(51:52), 'uint16') == 0, "the robot refuses");
            number = number + 1;
        elseif data(6) == 128                                    % STATUS
            fprintf("%.3f mm\n", typecast(data(41:48), 'double'));
        end
    end
end

% Range of one axis, for a capture side: after HELLO and RESET, allowed = inf.
function [is_beyond, allowed] = range_beyond(measured, least, most, allowed, tolerance)
    distance = max([least - measured, measured - most, 0]);
    is_beyond = distance > allowed + tolerance;
    allowed = min(allowed, distance);
end
