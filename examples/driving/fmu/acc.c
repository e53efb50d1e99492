/* An adaptive cruise control as a co-simulation FMU (FMI 2.0), the smallest that drives. */
#include <stdlib.h>
#include <string.h>

enum { GAP, RELATIVE_SPEED, EGO_SPEED, SET_SPEED, ACCEL, HEADWAY, COUNT };
typedef struct { double v[COUNT]; } Model;

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *f, int v, int l) {
    Model *m = calloc(1, sizeof *m);
    m->v[HEADWAY] = 1.5;
    return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2SetupExperiment(void *m, int d, double t, double s, int e, double p) { return 0; }
int fmi2EnterInitializationMode(void *m) { return 0; }
int fmi2ExitInitializationMode(void *m) { return 0; }
int fmi2Terminate(void *m) { return 0; }
int fmi2Reset(void *m) { memset(m, 0, sizeof(Model)); ((Model *)m)->v[HEADWAY] = 1.5; return 0; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *x) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = x[i];
    return 0;
}
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *x) {
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)m)->v[r[i]];
    return 0;
}
int fmi2DoStep(void *model, double t, double h, int keep) {
    double *v = ((Model *)model)->v;
    double free = 0.8 * (v[SET_SPEED] - v[EGO_SPEED]);
    double follow = 0.4 * (v[GAP] - 3.0 - v[HEADWAY] * v[EGO_SPEED]) + 1.2 * v[RELATIVE_SPEED];
    double a = free < follow ? free : follow;
    v[ACCEL] = a < -8.0 ? -8.0 : a > 2.0 ? 2.0 : a;
    return 0;
}
#define NOT_USED(name) int name(void) { return 3; }
NOT_USED(fmi2SetDebugLogging) NOT_USED(fmi2GetInteger) NOT_USED(fmi2GetBoolean) NOT_USED(fmi2GetString)
NOT_USED(fmi2SetInteger) NOT_USED(fmi2SetBoolean) NOT_USED(fmi2SetString) NOT_USED(fmi2GetFMUstate)
NOT_USED(fmi2SetFMUstate) NOT_USED(fmi2FreeFMUstate) NOT_USED(fmi2SerializedFMUstateSize)
NOT_USED(fmi2SerializeFMUstate) NOT_USED(fmi2DeSerializeFMUstate) NOT_USED(fmi2GetDirectionalDerivative)
NOT_USED(fmi2SetRealInputDerivatives) NOT_USED(fmi2GetRealOutputDerivatives) NOT_USED(fmi2CancelStep)
NOT_USED(fmi2GetStatus) NOT_USED(fmi2GetRealStatus) NOT_USED(fmi2GetIntegerStatus)
NOT_USED(fmi2GetBooleanStatus) NOT_USED(fmi2GetStringStatus)
