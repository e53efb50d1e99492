/* An FMU for tests, of FMI 2 or 3: x = rate t, y = x + offset + 10 mode, +1 with the flag. From t = 0.5 it has a fault. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#ifndef FMI
#define FMI 2
#endif

enum { X, RATE, OFFSET, Y, REALS };
enum { FAULT, SEED, INTEGERS };
enum { NONE, NOT_A_NUMBER, ABORT, HANG, ERROR, END };
typedef struct {
    double v[REALS], time;
    int i[INTEGERS], flag, mode, ended;
    void *log, *environment;
} Model;

static void restart(Model *m) {
    memset(m->v, 0, sizeof m->v);
    memset(m->i, 0, sizeof m->i);
    m->v[RATE] = 1;
    m->time = m->flag = m->mode = m->ended = 0;
}
static void update(Model *m) {
    m->v[X] = m->v[RATE] * m->time;
    m->v[Y] = m->v[X] + m->v[OFFSET] + 10 * m->mode + m->flag;
}
static int advance(Model *m, double h) {
    const int fault = m->time > 0.45 ? m->i[FAULT] : NONE;
    if (fault == ABORT) abort();
    if (fault == HANG) for (;;) sleep(1);
    if (fault == ERROR) return 3;
    if (fault == END && FMI == 2) { m->ended = 1; return 2; }
    m->ended = fault == END;
    m->time += h;
    update(m);
    if (fault == NOT_A_NUMBER) m->v[Y] = NAN;
    return 0;
}
#define M(x) ((Model *)(x))
#define SET(type, field) do { for (size_t k = 0; k < n; k++) field = (type)x[k]; return 0; } while (0)
#define GET(field) do { for (size_t k = 0; k < n; k++) x[k] = field; return 0; } while (0)

#if FMI == 2
typedef void (*Log)(void *, const char *, int, const char *, const char *, ...);
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void **f, int v, int l) {
    Model *m = calloc(1, sizeof *m);
    m->log = (void *)f[0];
    restart(m);
    return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2Reset(void *m) { restart(m); return 0; }
int fmi2SetupExperiment(void *m, int d, double t, double s, int e, double p) { return 0; }
int fmi2EnterInitializationMode(void *m) { return 0; }
int fmi2ExitInitializationMode(void *m) { update(m); return 0; }
int fmi2Terminate(void *m) { return 0; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *x) { SET(double, M(m)->v[r[k]]); }
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *x) { GET(M(m)->v[r[k]]); }
int fmi2SetInteger(void *m, const unsigned *r, size_t n, const int *x) {
    SET(int, *(r[k] < INTEGERS ? &M(m)->i[r[k]] : &M(m)->mode));
}
int fmi2GetInteger(void *m, const unsigned *r, size_t n, int *x) {
    GET(r[k] < INTEGERS ? M(m)->i[r[k]] : M(m)->mode);
}
int fmi2SetBoolean(void *m, const unsigned *r, size_t n, const int *x) { SET(int, M(m)->flag); }
int fmi2GetBoolean(void *m, const unsigned *r, size_t n, int *x) { GET(M(m)->flag); }
int fmi2DoStep(void *m, double t, double h, int keep) {
    const int status = advance(m, h);
    if (status == 3) ((Log)M(m)->log)(NULL, "model", 3, "error", "the solver failed at %g", M(m)->time);
    return status;
}
int fmi2GetBooleanStatus(void *m, int kind, int *x) { *x = M(m)->ended; return 0; }
int fmi2GetRealStatus(void *m, int kind, double *x) { *x = M(m)->time; return 0; }
#define NOT_USED(name) int name(void) { return 3; }
NOT_USED(fmi2SetDebugLogging) NOT_USED(fmi2GetString) NOT_USED(fmi2SetString) NOT_USED(fmi2GetFMUstate)
NOT_USED(fmi2SetFMUstate) NOT_USED(fmi2FreeFMUstate) NOT_USED(fmi2SerializedFMUstateSize)
NOT_USED(fmi2SerializeFMUstate) NOT_USED(fmi2DeSerializeFMUstate) NOT_USED(fmi2GetDirectionalDerivative)
NOT_USED(fmi2SetRealInputDerivatives) NOT_USED(fmi2GetRealOutputDerivatives) NOT_USED(fmi2CancelStep)
NOT_USED(fmi2GetStatus) NOT_USED(fmi2GetIntegerStatus) NOT_USED(fmi2GetStringStatus)
#else
typedef void (*Log)(void *, int, const char *, const char *);
const char *fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(const char *n, const char *g, const char *r, _Bool v, _Bool l, _Bool e, _Bool a,
                                  const unsigned *q, size_t c, void *environment, void *log, void *u) {
    Model *m = calloc(1, sizeof *m);
    m->log = log;
    m->environment = environment;
    restart(m);
    return m;
}
void fmi3FreeInstance(void *m) { free(m); }
int fmi3Reset(void *m) { restart(m); return 0; }
int fmi3EnterInitializationMode(void *m, _Bool d, double o, double t, _Bool e, double s) { return 0; }
int fmi3ExitInitializationMode(void *m) { update(m); return 0; }
int fmi3Terminate(void *m) { return 0; }
int fmi3SetFloat64(void *m, const unsigned *r, size_t n, const double *x, size_t c) { SET(double, M(m)->v[r[k]]); }
int fmi3GetFloat64(void *m, const unsigned *r, size_t n, double *x, size_t c) { GET(M(m)->v[r[k]]); }
int fmi3SetInt32(void *m, const unsigned *r, size_t n, const int32_t *x, size_t c) { SET(int, M(m)->i[r[k] - REALS]); }
int fmi3GetInt32(void *m, const unsigned *r, size_t n, int32_t *x, size_t c) { GET(M(m)->i[r[k] - REALS]); }
int fmi3SetInt64(void *m, const unsigned *r, size_t n, const int64_t *x, size_t c) { SET(int, M(m)->mode); }
int fmi3GetInt64(void *m, const unsigned *r, size_t n, int64_t *x, size_t c) { GET(M(m)->mode); }
int fmi3SetBoolean(void *m, const unsigned *r, size_t n, const _Bool *x, size_t c) { SET(int, M(m)->flag); }
int fmi3GetBoolean(void *m, const unsigned *r, size_t n, _Bool *x, size_t c) { GET(M(m)->flag); }
int fmi3DoStep(void *m, double t, double h, _Bool keep, _Bool *event, _Bool *end, _Bool *early, double *reached) {
    const int status = advance(m, h);
    if (status == 3) ((Log)M(m)->log)(M(m)->environment, 3, "error", "the solver failed at 0.5");
    *event = *early = 0;
    *end = M(m)->ended;
    *reached = M(m)->time;
    return status;
}
#define NOT_USED(name) int fmi3##name(void) { return 3; }
NOT_USED(SetDebugLogging) NOT_USED(InstantiateModelExchange) NOT_USED(InstantiateScheduledExecution)
NOT_USED(EnterEventMode) NOT_USED(GetFloat32) NOT_USED(GetInt8) NOT_USED(GetUInt8) NOT_USED(GetInt16)
NOT_USED(GetUInt16) NOT_USED(GetUInt32) NOT_USED(GetUInt64) NOT_USED(GetString) NOT_USED(GetBinary)
NOT_USED(GetClock) NOT_USED(SetFloat32) NOT_USED(SetInt8) NOT_USED(SetUInt8) NOT_USED(SetInt16) NOT_USED(SetUInt16)
NOT_USED(SetUInt32) NOT_USED(SetUInt64) NOT_USED(SetString) NOT_USED(SetBinary) NOT_USED(SetClock)
NOT_USED(GetNumberOfVariableDependencies) NOT_USED(GetVariableDependencies) NOT_USED(GetFMUState)
NOT_USED(SetFMUState) NOT_USED(FreeFMUState) NOT_USED(SerializedFMUStateSize) NOT_USED(SerializeFMUState)
NOT_USED(DeserializeFMUState) NOT_USED(GetDirectionalDerivative) NOT_USED(GetAdjointDerivative)
NOT_USED(EnterConfigurationMode) NOT_USED(ExitConfigurationMode) NOT_USED(GetIntervalDecimal)
NOT_USED(GetIntervalFraction) NOT_USED(GetShiftDecimal) NOT_USED(GetShiftFraction) NOT_USED(SetIntervalDecimal)
NOT_USED(SetIntervalFraction) NOT_USED(SetShiftDecimal) NOT_USED(SetShiftFraction) NOT_USED(EvaluateDiscreteStates)
NOT_USED(UpdateDiscreteStates) NOT_USED(EnterContinuousTimeMode) NOT_USED(CompletedIntegratorStep)
NOT_USED(SetTime) NOT_USED(SetContinuousStates) NOT_USED(GetContinuousStateDerivatives) NOT_USED(GetEventIndicators)
NOT_USED(GetContinuousStates) NOT_USED(GetNominalsOfContinuousStates) NOT_USED(GetNumberOfEventIndicators)
NOT_USED(GetNumberOfContinuousStates) NOT_USED(EnterStepMode) NOT_USED(GetOutputDerivatives)
NOT_USED(ActivateModelPartition)
#endif
