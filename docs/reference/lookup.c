/* Look up one pose in a needleplan policy table of the plane (table.md), with libhdf5:
 *
 *     h5cc lookup.c -o lookup -lm && ./lookup table.h5 40 36 0.1 -1
 */
#include <hdf5.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static void fail(const char *what) { fprintf(stderr, "lookup: %s\n", what); exit(2); }

/* Reads one element of a dataset [x, y, heading, bevel]. */
static void element(hid_t file, const char *name, hid_t type, const hsize_t at[4], void *value) {
    const hsize_t one[4] = {1, 1, 1, 1};
    hid_t data = H5Dopen2(file, name, H5P_DEFAULT);
    hid_t place = data < 0 ? -1 : H5Dget_space(data), memory = H5Screate_simple(4, one, NULL);
    if (place < 0 || H5Sselect_hyperslab(place, H5S_SELECT_SET, at, NULL, one, NULL) < 0 ||
        H5Dread(data, type, memory, place, H5P_DEFAULT, value) < 0)
        fail("this is no policy table");
    H5Sclose(memory), H5Sclose(place), H5Dclose(data);
}

int main(int count, char **words) {
    if (count != 6) fail("usage: lookup TABLE.h5 X_MM Y_MM HEADING_RAD BEVEL");
    hid_t file = H5Fopen(words[1], H5F_ACC_RDONLY, H5P_DEFAULT);
    if (file < 0) fail("the file cannot be read");

    double spacing_mm[2];
    hid_t attribute = H5Aopen(file, "spacing_mm", H5P_DEFAULT);
    if (attribute < 0 || H5Aread(attribute, H5T_NATIVE_DOUBLE, spacing_mm) < 0) fail("this is no policy table");
    H5Aclose(attribute);
    hid_t table = H5Dopen2(file, "policy", H5P_DEFAULT), space = H5Dget_space(table);
    hsize_t size[4];
    if (H5Sget_simple_extent_ndims(space) != 4) fail("this is no policy table in a plane");
    H5Sget_simple_extent_dims(space, size, NULL);
    H5Sclose(space), H5Dclose(table);

    double i = rint(atof(words[2]) / spacing_mm[0]), j = rint(atof(words[3]) / spacing_mm[1]);
    double k = fmod(rint(atof(words[4]) * size[2] / (2 * 3.14159265358979323846)), size[2]);
    if (!(i >= 0 && i < size[0] && j >= 0 && j < size[1]) || isnan(k)) fail("the pose is outside of the workspace");
    const hsize_t at[4] = {i, j, k < 0 ? k + size[2] : k, atof(words[5]) > 0};

    unsigned char action;
    float value, success;
    element(file, "policy", H5T_NATIVE_UCHAR, at, &action);
    element(file, "values", H5T_NATIVE_FLOAT, at, &value);
    element(file, "success", H5T_NATIVE_FLOAT, at, &success);
    H5Fclose(file);
    const char *names[] = {"insert", "rotate, then insert", "insert straight"};
    printf("%s; success %.4f, cost %.4f\n", names[action % 3], success, value);
    return 0;
}
