% h5read(file, dataset): a dataset in the root of a file, read by Octave's own import of HDF5, which MATLAB's h5read agrees
% with in the order of the axes. Octave imports 32-bit floats as 64-bit ones. Used where the package hdf5oct is missing.
function data = h5read(file, dataset)
  name = dataset(2:end);
  found = load("-hdf5", file, name);
  data = found.(name);
end
