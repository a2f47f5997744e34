% Look up one pose in a needleplan policy table of the plane (table.md). MATLAB counts from one, and shows the axes
% in reverse: [bevel, heading, y, x].
policy  = h5read('table.h5', '/policy');          % 2 x headings x ny x nx, uint8
success = h5read('table.h5', '/success');
spacing = h5readatt('table.h5', '/', 'spacing_mm');
headings = numel(h5read('table.h5', '/heading_rad'));

x_mm = 40; y_mm = 36; heading_rad = 0.1; bevel = -1;
i = round(x_mm / spacing(1)) + 1;
j = round(y_mm / spacing(2)) + 1;
k = mod(round(heading_rad / (2 * pi / headings)), headings) + 1;
b = (bevel + 3) / 2;                              % 1: bevel -1, 2: bevel +1
rotate_first = policy(b, k, j, i) == 1;
probability  = success(b, k, j, i);
scenario = h5readatt('table.h5', '/', 'scenario');
